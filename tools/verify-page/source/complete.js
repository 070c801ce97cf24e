// Level (f): which numbers of a topic are present. A recorder's head says how high they were at a time; nothing is claimed
// after that. Only records whose signer is proven count: anybody can seal a record in another's name.

import { hex } from "./bytes.js";
import { heightLeaf, leadsTo } from "./merkle.js";
import { OWN_CHAIN, PROVEN, REFUSED, UNPROVEN } from "./outcome.js";
import { BIRTH, HEADS, RECORDER_TOPIC, isRing, parseHeads } from "./record.js";

const MOST_GAPS = 100;

export const isBelieved = (record) => [PROVEN, OWN_CHAIN].includes(record.key.standing);

/** Whether it opened as a recorder's statement about completeness; bundles add these to what was chosen. */
export const isStatement = ({ disclosed }) =>
  disclosed?.topic === RECORDER_TOPIC && [BIRTH, HEADS].includes(disclosed.type);

const recorderOf = ({ owner, signer, recorder }) => [owner, signer, recorder].map(hex).join();

/** Topics of each recorder in order, with what is there of each. */
export function stretchesOf(heights, records) {
  const topics = new Map();
  for (const record of records.filter((one) => one.bytes.standing === PROVEN)) {
    const name = `${recorderOf(record)},${hex(record.topicId)}`;
    if (!topics.has(name)) topics.set(name, []);
    topics.get(name).push(record);
  }
  const claims = claimsOf(heights, records);
  return [...topics.keys()].sort().map((name) => {
    const ones = topics.get(name);
    const stretch = stretchOf(ones, claims.get(name) ?? []);
    const believed = ones.filter(isBelieved);
    stretch.isOwnStatements = believed.length > 0 && believed.every(isStatement);
    // They were included for the sake of other topics, or asked for one by one: nobody claims that these are all.
    const isOpen = stretch.isOwnStatements || isRing(stretch.recorder);
    return isOpen ? { ...stretch, gaps: [], missing: 0n, heads: undefined } : stretch;
  });
}

/** Heads of recorders whose signer is proven, and whose message opened. */
function headsOf(records) {
  const those = records.filter((one) => isBelieved(one) && one.statement?.type === HEADS);
  const found = those.map((record) => ({ record, found: parseHeads(record.statement.body) }));
  return new Map(found.filter((one) => one.found).map((one) => [hex(one.record.digest), one]));
}

/** Entries of heights.json by topic, in the order of their heads; without a number where the path leads elsewhere. */
function claimsOf(heights, records) {
  const heads = headsOf(records);
  const claims = new Map();
  for (const { heads: digest, topic, number, index, path } of heights) {
    const head = heads.get(hex(digest));
    if (!head) continue;
    const name = `${recorderOf(head.record)},${hex(topic)}`;
    const isLeading = leadsTo(head.found.root, heightLeaf(topic, number), index, head.found.count, path);
    if (!claims.has(name)) claims.set(name, []);
    claims.get(name).push({ record: head.record, number: isLeading ? number : undefined });
  }
  for (const ones of claims.values()) ones.sort((one, other) => Number(one.record.seq - other.record.seq));
  return claims;
}

/** Whether heads contradict themselves or each other: a path that leads elsewhere, a number that decreased. */
const contradict = (claims) =>
  claims.some(({ number }, at) => number === undefined || (at > 0 && number < claims[at - 1].number));

function stretchOf(ones, claims) {
  const { owner, signer, recorder, topicId } = ones[0];
  const bySeq = new Map();
  for (const one of ones) bySeq.set(one.seq, [...(bySeq.get(one.seq) ?? []), one]);
  const inOrder = [...bySeq.keys()].sort((one, other) => Number(one - other));
  const numbers = inOrder.filter((seq) => bySeq.get(seq).some(isBelieved));
  const twice = inOrder.filter((seq) => bySeq.get(seq).length > 1 && bySeq.get(seq).some(isBelieved));
  const last = claims.at(-1);
  const heads =
    last?.number === undefined
      ? undefined
      : { record: last.record.digest, number: last.number, at: last.record.anchoredAt };
  const isOwn = [...ones, ...(last ? [last.record] : [])].some((one) => one.key.standing === OWN_CHAIN);
  const gaps = gapsIn(numbers, heads);
  const isRefused = twice.length > 0 || contradict(claims);
  const counted = numbers.length ? (isOwn ? OWN_CHAIN : PROVEN) : UNPROVEN;
  return {
    owner,
    signer,
    recorder,
    topicId,
    standing: isRefused ? REFUSED : counted,
    reason: isRefused ? (twice.length ? "two_histories" : "false_heads") : undefined,
    first: numbers[0],
    last: numbers.at(-1),
    gaps: gaps.slice(0, MOST_GAPS),
    missing: gaps.reduce((sum, [from, to]) => sum + to - from + 1n, 0n),
    uncounted: ones.filter((one) => !isBelieved(one)).length,
    twice,
    heads,
  };
}

/** Numbers missing between those that are there, and up to the one that the head names. */
function gapsIn(numbers, heads) {
  const gaps = [];
  for (let at = 1; at < numbers.length; at++) {
    if (numbers[at] - numbers[at - 1] > 1n) gaps.push([numbers[at - 1] + 1n, numbers[at] - 1n]);
  }
  const last = numbers.at(-1);
  if (last !== undefined && heads && heads.number > last) gaps.push([last + 1n, heads.number]);
  return gaps;
}
