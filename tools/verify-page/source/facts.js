// What a verdict can speak of: counts, groups and spans of a report, by the names that sentences.json explains.

import { address } from "./accounts.js";
import { hex } from "./bytes.js";
import { LEVELS, isProven, isSelfSealed } from "./check.js";
import { isStatement } from "./complete.js";
import { clean } from "./display.js";
import { OWN_CHAIN, PROVEN, REFUSED } from "./outcome.js";
import { isRing } from "./record.js";
import { WORDING, filled, grouped } from "./wording.js";

const LETTERS = { bytes: "a", key: "b", anchor: "c", time: "d", opened: "e" };
const NANO = 1_000_000_000n;
/** The last second whose nanoseconds a ledger can hold. */
const LAST_SECOND = ((1n << 63n) - 1n) / NANO;

const isIntact = (record) => record.bytes.standing === PROVEN;
const isReadable = (record) => record.disclosed !== undefined && !isStatement(record);

/** Date and clock of a second, UTC. */
const written = (seconds) => new Date(Number(seconds) * 1000).toISOString();
const date = (seconds) => written(seconds).slice(0, 10);
const clock = (seconds) => written(seconds).slice(11, 19);
const moment = (seconds) => `${date(seconds)} ${clock(seconds)} UTC`;

function span(first, last) {
  if (first === undefined) return "";
  const [one, other] = [first / NANO, last / NANO];
  if (one === other) return moment(one);
  const day = date(one) === date(other) ? "" : `${date(other)} `;
  return `${date(one)} ${clock(one)} to ${day}${clock(other)} UTC`;
}

/** How many records, and the span of their capture times. */
class Group {
  count = 0;

  add({ capturedAt: at }) {
    this.count += 1;
    if (at === undefined) return;
    if (this.first === undefined || at < this.first) this.first = at;
    if (this.last === undefined || at > this.last) this.last = at;
  }

  static of(records) {
    const group = new Group();
    for (const record of records) group.add(record);
    return group;
  }

  get span() {
    return span(this.first, this.last);
  }
}

/** Compares parts of two lists, the first that differ. */
export function inOrder(one, other) {
  for (const [at, part] of one.entries()) {
    if (part !== other[at]) return part < other[at] ? -1 : 1;
  }
  return 0;
}

/** Text in the order of its bytes in UTF-8, which is that of its characters' numbers. */
const byText = (text) =>
  Array.from(text, (character) => character.codePointAt(0).toString(16).padStart(6, "0")).join("");

/** Groups by what `nameOf` says, as pairs of the name's parts and what `make` begins and `add` continues. */
function groups(records, nameOf, make, add) {
  const found = new Map();
  for (const record of records) {
    const parts = nameOf(record);
    const name = JSON.stringify(parts);
    if (!found.has(name)) found.set(name, { parts, of: make() });
    add(found.get(name).of, record);
  }
  return [...found.values()];
}

/** The anchor's time in seconds, where it counts and a person could read it. */
function anchoredAt({ anchor, anchoredAt: at }) {
  const isSupported = anchor.standing === PROVEN || anchor.standing === OWN_CHAIN;
  return isSupported && at !== undefined && at <= LAST_SECOND ? at : undefined;
}

/** What topics are called: by their own disclosed records, or by a label. */
class Names {
  known = new Map();

  constructor(records) {
    for (const record of records.filter((one) => one.disclosed)) {
      const id = hex(record.signer) + hex(record.topicId);
      if (!this.known.has(id)) this.known.set(id, record.disclosed.topic);
    }
  }

  topic({ signer, topicId }) {
    const name = this.known.get(hex(signer) + hex(topicId));
    if (name !== undefined) return clean(name, WORDING.longest);
    return filled(WORDING.labels.sealed, [{ id: hex(topicId).slice(0, 8) }]);
  }

  record(record) {
    if (isStatement(record)) return WORDING.labels.recorder;
    return record.signer ? this.topic(record) : WORDING.labels.unreadable;
  }
}

export function factsOf(report) {
  const { records, complete, exporter, outcome, context } = report;
  const names = new Names(records);
  const count = (holds) => records.filter(holds).length;
  const [statements, readable, intact] = [isStatement, isReadable, isIntact].map(count);
  const topics = (holds) => complete.filter(holds).length;
  const all = {
    holds: outcome === "holds",
    refused: outcome === "refused",
    trust: report.isPinned,
    self_sealed: outcome === "incomplete" && isSelfSealed(records),
    unknown_exporter: outcome === "incomplete" && report.isPinned && isProven(records) && exporter.standing !== PROVEN,
    records: records.length,
    statements,
    intact,
    altered: records.length - intact,
    exporter: address(context.exporter),
    exporter_person: clean(context.person ?? "", WORDING.longest),
    exporter_proven: exporter.standing === PROVEN,
    exporter_self_sealed: exporter.standing === OWN_CHAIN,
    exporter_refused: exporter.standing === REFUSED,
    undated: count((one) => one.existedBefore === undefined && anchoredAt(one) === undefined),
    captured: Group.of(records.filter((one) => isIntact(one) && !isStatement(one))).span,
    readable_count: readable,
    sealed: records.length - readable - statements,
    complete: topics((one) => isCounted(one) && hasHeads(one) && one.missing === 0n),
    gapless: topics((one) => isCounted(one) && hasHeads(one) && beyond(one) > 0n && between(one) === 0n),
    unstated: topics((one) => isCounted(one) && !hasHeads(one)),
    rings: topics((one) => isRing(one.recorder) && one.first !== undefined),
    trust_denies: context.trustDenies,
    late_capture: records.some((one) => one.secondsToAnchor < 0n),
    foreign_instructions: context.foreignInstructions,
    levels: levelsIn(report),
    worst: levelsIn(report, false),
  };
  const lists = {
    signed: signed(records),
    stamped: stamped(records),
    anchored: anchored(records),
    readable: readableIn(records),
    missing: numbered(names, complete, between, (one) => one.last),
    later: numbered(names, complete, beyond, (one) => one.heads.number),
    doubts: doubts(names, report),
  };
  return { all, lists };
}

function isCounted(stretch) {
  const isBelievedIn = stretch.standing === PROVEN || stretch.standing === OWN_CHAIN;
  return isBelievedIn && stretch.first !== undefined && !stretch.isOwnStatements && !isRing(stretch.recorder);
}

const hasHeads = ({ heads, first }) => heads !== undefined && first !== undefined && heads.number >= first;

/** How many numbers the newest head names above the last one here. */
const beyond = ({ heads, last }) => (heads && last !== undefined && heads.number > last ? heads.number - last : 0n);

/** How many are missing between the first and the last. */
const between = (stretch) => stretch.missing - beyond(stretch);

/** `(a) bytes: proven; (b) signer: 8 self-sealed chain, 3 not proven`, or only the last of each. */
function levelsIn({ records, complete }, counted = true) {
  const found = LEVELS.map((name) => [LETTERS[name], records.map((record) => record[name].standing)]);
  found.push(["f", complete.map((stretch) => stretch.standing)]);
  const told = found
    .filter(([, standings]) => standings.length)
    .map(([letter, standings]) => {
      const number = (standing) => standings.filter((one) => one === standing).length;
      const counts = Object.entries(WORDING.standings).map(([standing, word]) => [number(standing), word]);
      const some = counts.filter(([many]) => many > 0);
      const words = some.map(([many, word]) => (some.length > 1 && counted ? `${grouped(many)} ${word}` : word));
      return `(${letter}) ${WORDING.levels[letter]}: ${counted ? words.join(", ") : words.at(-1)}`;
    });
  return told.join("; ");
}

/** The largest first, then by these parts of their names. */
const largestFirst = (list, parts) =>
  list.sort((one, other) => inOrder([-one.of.count, ...parts(one)], [-other.of.count, ...parts(other)]));

function signed(records) {
  const classOf = ({ key }) => (key.standing === PROVEN ? 0 : key.standing === OWN_CHAIN ? 1 : 2);
  const nameOf = (record) => [hex(record.owner), classOf(record)];
  const add = (of, record) => Object.assign(of, { count: of.count + 1, owner: record.owner, person: record.person });
  const list = groups(records.filter(isIntact), nameOf, () => ({ count: 0 }), add);
  return largestFirst(list, (one) => one.parts).map(({ parts, of }) => ({
    account: address(of.owner),
    person: clean(of.person ?? "", WORDING.longest),
    proven: parts[1] === 0,
    self_sealed: parts[1] === 1,
    count: of.count,
  }));
}

function stamped(records) {
  const those = records.filter((one) => one.authority !== undefined);
  const add = (of, { existedBefore: at }) => Object.assign(of, { count: of.count + 1, time: Math.max(of.time, at) });
  const list = groups(
    those,
    (one) => [clean(one.authority, WORDING.longest)],
    () => ({ count: 0, time: 0 }),
    add,
  );
  return largestFirst(list, ({ parts }) => parts.map(byText)).map(({ parts, of }) => ({
    authority: parts[0],
    time: moment(of.time),
    count: of.count,
  }));
}

function anchored(records) {
  const of = (standing) => {
    const times = records.filter((one) => one.anchor.standing === standing).map(anchoredAt);
    const known = times.filter((at) => at !== undefined);
    const latest = known.reduce((one, other) => (one > other ? one : other), -1n);
    return { proven: standing === PROVEN, self_sealed: standing === OWN_CHAIN, time: latest, count: known.length };
  };
  const list = [PROVEN, OWN_CHAIN].map(of).filter(({ count }) => count > 0);
  return list.map((one) => ({ ...one, time: moment(one.time) }));
}

const addTo = (group, record) => group.add(record);

function readableIn(records) {
  const nameOf = (one) => [clean(one.disclosed.topic, WORDING.longest)];
  const list = groups(records.filter(isReadable), nameOf, () => new Group(), addTo);
  const inTurn = largestFirst(list, ({ parts }) => parts.map(byText));
  return inTurn.map(({ parts, of }) => ({ topic: parts[0], span: of.span, count: of.count }));
}

/** The topics with such a number of numbers, the largest first. */
function numbered(names, complete, number, end) {
  const those = complete.filter((one) => number(one) > 0n);
  const list = those.map((one) => ({ topic: names.topic(one), from: one.first, to: end(one), count: number(one) }));
  const parts = (one) => [-one.count, byText(one.topic), one.from, one.to];
  return list.sort((one, other) => inOrder(parts(one), parts(other)));
}

/** All that is not proven or refused, by level, topic and reason; what merely follows from another level has no reason. */
function doubts(names, { records, complete }) {
  const found = records.flatMap((record) => {
    const levels = isIntact(record) ? LEVELS : ["bytes"];
    const those = levels.map((name) => ({ letter: LETTERS[name], ...record[name] })).filter(({ reason }) => reason);
    return those.map((one) => ({ ...one, record, topic: names.record(record) }));
  });
  const laneOf = (one) => ["owner", "signer", "recorder", "topicId"].map((name) => hex(one[name])).join();
  const lanes = new Map();
  for (const record of records.filter(isIntact)) {
    const lane = laneOf(record);
    if (!lanes.has(lane)) lanes.set(lane, []);
    lanes.get(lane).push(record);
  }
  for (const stretch of complete.filter(({ reason }) => reason)) {
    const one = { letter: "f", standing: REFUSED, reason: stretch.reason, topic: names.topic(stretch) };
    for (const record of lanes.get(laneOf(stretch)) ?? []) found.push({ ...one, record });
  }
  const nameOf = (one) => [one.standing === REFUSED ? 0 : 1, one.letter, one.topic, one.reason];
  const list = groups(
    found,
    nameOf,
    () => new Group(),
    (group, one) => group.add(one.record),
  );
  const parts = ({ parts: [accepted, letter, topic, reason], of }) => [
    accepted,
    letter,
    -of.count,
    byText(topic),
    reason,
  ];
  const inTurn = list.sort((one, other) => inOrder(parts(one), parts(other)));
  return inTurn.map(({ parts: [accepted, , topic, reason], of }) => ({
    topic,
    span: of.span,
    why: WORDING.reasons[reason],
    refused: accepted === 0,
    count: of.count,
  }));
}
