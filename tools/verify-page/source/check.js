// The check of a bundle against its reader's pins, level by level. What many records ask is found out once.

import { ascii, concat, equal, hex, unhex } from "./bytes.js";
import { findAnchor, sealedLevel } from "./anchor.js";
import { readBundle } from "./bundle.js";
import { isStatement, isBelieved, stretchesOf } from "./complete.js";
import { clean } from "./display.js";
import { existedLevel, stampsOf } from "./existed.js";
import {
  ABSENT,
  Broken,
  OWN_CHAIN,
  PROVEN,
  REFUSED,
  Refused,
  UNPROVEN,
  Unproven,
  judged,
  level,
  refusing,
} from "./outcome.js";
import { RECORDER_TOPIC, disclosed, domainOf, opened, parseHeader } from "./record.js";
import { rightOf, vouched } from "./right.js";
import { sm3 } from "./sm3.js";

const MOST_PLAIN = 256 * 2 ** 20;
const SECOND = 1_000_000_000n;
/** Records between two reports of progress. */
const STEP = 25;
const NEEDED = ["bytes", "key", "anchor"];
export const LEVELS = ["bytes", "key", "anchor", "time", "opened"];

/** A state is worth as much as the seals on it. */
function capped(found, anchor) {
  if (found.standing !== PROVEN || anchor.standing === PROVEN) return found;
  if (anchor.standing === OWN_CHAIN) return { ...found, standing: OWN_CHAIN };
  return level(UNPROVEN);
}

const isSealed = (anchor) => [PROVEN, OWN_CHAIN].includes(anchor.standing);

class Check {
  left = { bytes: MOST_PLAIN };
  known = new Map();

  constructor(bundle, trust, stamps) {
    const chain = trust?.chain ?? bundle.manifest.chain;
    Object.assign(this, { bundle, trust, stamps, contract: chain.contract, domain: domainOf(chain) });
    this.once = this.once.bind(this);
  }

  /** The result of `find`, or what it threw, by what was asked. */
  once(asked, find) {
    if (!this.known.has(asked)) this.known.set(asked, settled(find));
    const { found, error } = this.known.get(asked);
    if (error) throw error;
    return found;
  }

  async record(name) {
    const record = { ...this.bundle.records.get(name), digest: unhex(name) };
    const report = { digest: record.digest, opened: level(ABSENT) };
    for (const one of ["key", "anchor", "time"]) report[one] = level(UNPROVEN);
    report.bytes = judged(() => this.bytes(record));
    const { header } = record;
    if (report.bytes.standing !== PROVEN) return report;
    const { owner, signer, recorder, topicId, seq, capturedAt } = header;
    Object.assign(report, { owner, signer, recorder, topicId, seq, capturedAt });
    const existed = existedLevel(this.stamps, record);
    Object.assign(report, { time: existed.level, existedBefore: existed.before, authority: existed.authority });
    const ownerKey = this.anchorAndKey(record, report);
    const secret = this.bundle.disclosure?.secrets.get(name);
    if (secret) await this.open(record, secret, report, ownerKey);
    return report;
  }

  bytes(record) {
    if (!equal(record.sm3, record.digest)) throw new Refused("not_as_filed");
    const { header, length } = refusing("not_a_record", () => parseHeader(record.bytes));
    const sealed = BigInt(header.headLength) + header.bodyLength;
    if (BigInt(record.bytes.length - length) !== sealed) throw new Refused("not_a_record");
    if (!equal(header.domain, this.domain)) throw new Refused("other_chain");
    const key = this.bundle.keys.get(hex(header.signer));
    if (!key) throw new Refused("signer_missing");
    const message = concat(ascii("AuthROS/signature/1"), header.domain, record.digest);
    if (!key.verify(message, record.signature)) throw new Refused("bad_signature");
    record.header = header;
    return level(PROVEN);
  }

  /** Levels (c) and (b); returns the owner's key at the anchoring block. */
  anchorAndKey(record, report) {
    let anchored;
    try {
      anchored = findAnchor(this, record);
    } catch (error) {
      if (!(error instanceof Refused || error instanceof Unproven)) throw error;
      report.anchor = error.level;
      return undefined;
    }
    report.anchor = sealedLevel(this, anchored);
    const right = rightOf(this, record.header, anchored);
    report.key = capped(right.level, report.anchor);
    if (isSealed(report.anchor)) report.ownerKey = right.ownerKey?.id;
    const person = isBelieved(report) ? this.trust?.person(report.owner) : undefined;
    report.person = person && clean(person.name, 80);
    report.block = anchored.block;
    if (anchored.time !== undefined) {
      report.anchoredAt = anchored.time;
      report.secondsToAnchor = anchored.time - report.capturedAt / SECOND;
    }
    return right.ownerKey;
  }

  async open(record, secret, report, ownerKey) {
    let found = vouched(this, record.header, ownerKey);
    if (found.standing !== REFUSED) {
      try {
        const message = await opened(record.bytes, secret, this.left);
        if (message) this.shown(report, message);
        else found = level(UNPROVEN, "too_much_disclosed");
      } catch (error) {
        if (!(error instanceof Broken)) throw error;
        found = level(REFUSED, "bad_disclosure");
      }
    }
    report.opened = capped(found, report.anchor);
  }

  shown(report, message) {
    report.disclosed = disclosed(message);
    const { topic, type } = message.head;
    if (topic === RECORDER_TOPIC) report.statement = { type, body: message.body };
  }

  exporter(records) {
    const { account, key } = this.bundle.manifest.exporter;
    const pinned = this.trust?.person(account)?.key;
    if (!this.bundle.isSigned) return level(REFUSED);
    if (pinned) return level(equal(pinned, key) ? PROVEN : UNPROVEN);
    // Anybody can put a record of his own beside those of others, and sign for them all.
    const isOthers = records.some((one) => one.owner && !equal(one.owner, account));
    const isTied = (one) => one.ownerKey && equal(one.ownerKey, key) && equal(one.owner, account);
    const tied = isOthers ? [] : records.filter(isTied).map((one) => one.anchor.standing);
    return level([PROVEN, OWN_CHAIN].find((standing) => tied.includes(standing)) ?? UNPROVEN);
  }

  /** What the verdict says besides the levels. */
  context(records, readMe) {
    const { account } = this.bundle.manifest.exporter;
    const isOwn = records.some((one) => one.anchor.standing === OWN_CHAIN);
    const instructions = this.bundle.hashed.get("VERIFY.txt");
    return {
      exporter: account,
      person: this.trust?.person(account)?.name,
      trustDenies: isOwn && this.trust !== undefined && !this.trust.chain.sealed_by_exporter,
      foreignInstructions: instructions !== undefined && !equal(instructions, sm3(readMe)),
    };
  }
}

function settled(find) {
  try {
    return { found: find() };
  } catch (error) {
    return { error };
  }
}

const neededOf = (record) => NEEDED.map((name) => record[name].standing);

/** A recorder's own statement of which something is not proven says nothing, and denies nothing. */
function isMute(record) {
  const needed = neededOf(record);
  return isStatement(record) && needed.includes(UNPROVEN) && !needed.includes(REFUSED);
}

/** The results of (a) to (c) that count. */
function countedStandings(records) {
  const spoken = records.filter((record) => !isMute(record));
  return (spoken.length ? spoken : records).flatMap(neededOf);
}

/** Whether (a) to (c) are proven for every record that counts. */
export const isProven = (records) => records.length > 0 && countedStandings(records).every((one) => one === PROVEN);

/** Whether they are proven at least by the exporter's own chain, and something by that alone. */
export const isSelfSealed = (records) =>
  records.length > 0 &&
  !isProven(records) &&
  countedStandings(records).every((one) => [PROVEN, OWN_CHAIN].includes(one));

function outcomeOf(trust, exporter, records, complete) {
  const levels = records.flatMap((record) => LEVELS.map((one) => record[one]));
  if ([exporter, ...complete, ...levels].some(({ standing }) => standing === REFUSED)) return "refused";
  // What was not checked here is not known to be right.
  const isChecked = levels.every(({ reason }) => reason !== "not_checked");
  return trust && isChecked && exporter.standing === PROVEN && isProven(records) ? "holds" : "incomplete";
}

/**
 * The report on a bundle's bytes; throws `Malformed` if they are not a bundle. `progress` hears of each stage and how much of
 * it is done. `readMe` is the text of VERIFY.txt that belongs into a bundle.
 */
export async function check(file, trust, { readMe, progress = () => {} }) {
  const bundle = await readBundle(file, progress);
  const made = new Check(bundle, trust, await stampsOf(bundle, trust));
  const names = [...bundle.records.keys()].sort();
  const records = [];
  const isRefused = (record) => LEVELS.some((one) => record[one].standing === REFUSED);
  let refused = 0;
  for (const name of names) {
    if (records.length % STEP === 0) progress("records", records.length, names.length, { refused });
    const record = await made.record(name);
    refused += isRefused(record) ? 1 : 0;
    records.push(record);
  }
  const complete = stretchesOf(bundle.heights, records);
  const exporter = made.exporter(records);
  const outcome = outcomeOf(trust, exporter, records, complete);
  return { outcome, isPinned: Boolean(trust), exporter, records, complete, context: made.context(records, readMe) };
}
