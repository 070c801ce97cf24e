// A report as JSON, with the names that `authros evidence verify --json` has for the same.

import { address } from "./accounts.js";
import { hex } from "./bytes.js";
import { LEVELS } from "./check.js";
import { rfc3339 } from "./display.js";
import { REFUSED } from "./outcome.js";
import { firstSentence, verdictOn } from "./verdict.js";

const SECOND = 1_000_000_000n;

const orNull = (value, write) => (value === undefined ? null : write(value));
const number = (value) => orNull(value, (big) => (big <= Number.MAX_SAFE_INTEGER ? Number(big) : String(big)));
const seconds = (value) => orNull(value, (at) => rfc3339(BigInt(at) * SECOND));
const digits = (value) => orNull(value, hex);

function shownRecord(record) {
  const { disclosed } = record;
  return {
    digest: hex(record.digest),
    owner: orNull(record.owner, address),
    person: record.person ?? null,
    signer: digits(record.signer),
    owner_key: digits(record.ownerKey),
    recorder: digits(record.recorder),
    topic_id: digits(record.topicId),
    seq: number(record.seq),
    captured_at: orNull(record.capturedAt, rfc3339),
    anchored_at: seconds(record.anchoredAt),
    block: number(record.block),
    seconds_to_anchor: number(record.secondsToAnchor),
    existed_before: seconds(record.existedBefore),
    authority: record.authority ?? null,
    ...Object.fromEntries(LEVELS.map((name) => [name, record[name]])),
    disclosed: disclosed
      ? {
          ...disclosed,
          messageSm3: undefined,
          message_sm3: hex(disclosed.messageSm3),
          tags: Object.fromEntries(disclosed.tags),
        }
      : null,
  };
}

const shownStretch = (stretch) => ({
  owner: address(stretch.owner),
  signer: hex(stretch.signer),
  recorder: hex(stretch.recorder),
  topic_id: hex(stretch.topicId),
  standing: stretch.standing,
  reason: stretch.reason,
  own_statements: stretch.isOwnStatements,
  first: number(stretch.first),
  last: number(stretch.last),
  gaps: stretch.gaps.map((gap) => gap.map(number)),
  missing: number(stretch.missing),
  uncounted: stretch.uncounted,
  twice: stretch.twice.map(number),
  heads: orNull(stretch.heads, (heads) => ({
    record: hex(heads.record),
    number: number(heads.number),
    at: seconds(heads.at),
  })),
});

export function shown(report) {
  return {
    outcome: report.outcome,
    verdict: verdictOn(report),
    pinned: report.isPinned,
    exporter: { account: address(report.context.exporter), ...report.exporter },
    records: report.records.map(shownRecord),
    complete: report.complete.map(shownStretch),
  };
}

/** Of a file that is not a bundle, and why not. */
export const refusal = (why) => ({
  outcome: REFUSED,
  verdict: [firstSentence(REFUSED), `Nothing in it counts: ${why}.`],
  pinned: null,
  exporter: null,
  records: [],
  complete: [],
});
