// The verdict in sentences, said by the rules of sentences.json, which every verifier prints from.

import { factsOf } from "./facts.js";
import { WORDING, filled, holds, wrapped } from "./wording.js";

function said(sentence, facts, most) {
  const first = (fields) => {
    const found = sentence.say.find(([condition]) => holds(condition, fields));
    return found?.[1] ? [filled(found[1], fields)] : [];
  };
  if (!sentence.each) return first([facts.all]);
  const items = facts.lists[sentence.each] ?? [];
  const texts = items.slice(0, most).flatMap((item) => first([item, facts.all]));
  const left = items.slice(most);
  if (left.length) {
    const count = left.reduce((sum, item) => sum + BigInt(item.count), 0n);
    texts.push(filled(sentence.more, [{ groups: left.length, count }, facts.all]));
  }
  return texts;
}

/** The sentences about a report, the outcome first. */
export const verdictOn = (report) => sentencesOf(factsOf(report));

/** The sentences about facts: lists, then what is spare, and at last sentences are shortened, until they fit. */
export function sentencesOf(facts) {
  const told = (most) =>
    WORDING.sentences.flatMap((one) => said(one, facts, most).map((text) => ({ one, text })));
  const isLong = (all) => all.flatMap(({ text }) => wrapped(text)).length > WORDING.lines;
  let most = WORDING.most;
  let all = told(most);
  while (most > 0 && isLong(all)) all = told(--most);
  while (isLong(all) && all.some(({ one }) => one.spare))
    all.splice(
      all.findLastIndex(({ one }) => one.spare),
      1,
    );
  if (isLong(all))
    all = all.map(({ one, text }) => ({ one, text: one.short ? filled(one.short, [facts.all]) : text }));
  return all.map(({ text }) => text);
}

/** The first sentence of a verdict with this outcome and nothing else known. */
export const firstSentence = (outcome) => said(WORDING.sentences[0], { all: { [outcome]: true } }, 0)[0];
