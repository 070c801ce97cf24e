// The list of the verdict's words, which all verifiers share, and how facts are written into them.

import WORDING from "../../../crates/evidence/src/verdict/sentences.json" with { type: "json" };

export { WORDING };

const INDENT = "  ";

/** A number with a comma before each three digits. */
export const grouped = (number) => String(number).replace(/\B(?=(\d{3})+$)/g, ",");

const lookUp = (fields, name) => fields.find((some) => some[name] !== undefined)?.[name];

/** Not 0, not empty, not false. */
const isThere = (fact) => Boolean(fact);

export const holds = (condition, fields) =>
  condition
    .split(" ")
    .filter(Boolean)
    .every((word) => (word[0] === "!" ? !isThere(lookUp(fields, word.slice(1))) : isThere(lookUp(fields, word))));

/** A text with its braces filled by facts. */
export function filled(text, fields) {
  return text.replace(/\{([^{}|]*)(?:\|([^{}|]*)\|([^{}|]*))?\}/g, (_, name, one, many) => {
    const fact = lookUp(fields, name);
    if (fact === undefined) return "";
    if (typeof fact === "string") return fact;
    return one === undefined ? grouped(fact) : `${grouped(fact)} ${Number(fact) === 1 ? one : many}`;
  });
}

/** A sentence in lines. */
export function wrapped(sentence) {
  const lines = [];
  for (const word of sentence.split(" ")) {
    const last = lines.at(-1);
    if (last === undefined) lines.push(word);
    else if ([...last].length + 1 + [...word].length <= WORDING.width) lines[lines.length - 1] = `${last} ${word}`;
    else lines.push(INDENT + word);
  }
  return lines;
}
