// Headers of blocks, and who sealed them: Clique (EIP-225), and QBFT and IBFT 2.0, whose seals are in one header.

import { keccak, recovered } from "./accounts.js";
import { ascii, equal, hex, isZero, numberBytes, startsWith } from "./bytes.js";
import { Broken } from "./outcome.js";
import { decode, encodeBytes, encodeList } from "./rlp.js";

export const LONGEST_HEADER = 8192;
const VANITY = 32;
const SEAL = 65;
const ACCOUNT = 20;
const EXTRA = 12;
const MIX = ascii("ctical byzantine fault tolerance");
const OURS = ascii("AuthROS chain file version ");
/** Rounds tried where the seals do not fit the header's own. */
const ROUNDS_TRIED = 16;

export const twoThirds = (validators) => Math.ceil((validators * 2) / 3);

export class BlockHeader {
  /** From its RLP; undefined if it is not a header. Forks add fields at the end, which are hashed as they are. */
  static parse(bytes) {
    if (bytes.length > LONGEST_HEADER) return undefined;
    const list = decode(bytes);
    const fields = list?.items;
    if (!fields || fields.length < 15 || fields.length > 32) return undefined;
    const header = new BlockHeader();
    header.fields = fields;
    header.parent = fields[0].fixed(32);
    header.stateRoot = fields[3].fixed(32);
    header.number = fields[8].number();
    header.timestamp = fields[11].number();
    header.extra = fields[EXTRA].bytes;
    header.mix = fields[13].bytes;
    const { parent, stateRoot, number, timestamp, extra, mix } = header;
    if ([parent, stateRoot, number, timestamp, extra, mix].includes(undefined)) return undefined;
    // The genesis block's hash is that of its bytes, whatever its extra data has.
    header.committed = equal(mix, MIX) && number > 0n ? Committed.parse(header) : undefined;
    header.hash = header.committed ? header.committed.blockHash() : keccak(bytes);
    return header;
  }

  /** Its hash with other extra data. */
  withExtra(extra) {
    const items = this.fields.map((field, at) => (at === EXTRA ? encodeBytes(extra) : field.source));
    return keccak(encodeList(items));
  }

  /** Who sealed it under Clique; undefined without such a seal. */
  sealer() {
    const between = this.extra.length - VANITY - SEAL;
    if (this.mix.length !== 32 || !isZero(this.mix) || between < 0 || between % ACCOUNT) return undefined;
    const begin = this.extra.length - SEAL;
    return recovered(this.withExtra(this.extra.subarray(0, begin)), this.extra.subarray(begin));
  }

  /** Whether it is of AuthROS's embedded chain, which one program seals with the keys of one home. */
  isOurs() {
    return startsWith(this.extra, OURS);
  }
}

/** Vanity, validators, vote, round and seals in the extra data. */
export class Committed {
  static parse(header) {
    const items = decode(header.extra)?.items;
    if (items?.length !== 5 || !items[0].fixed(VANITY) || items[3].isList || !items[1].isList || !items[4].isList) {
      return undefined;
    }
    const validators = items[1].items.map((item) => item.fixed(ACCOUNT));
    const seals = items[4].items.map((item) => item.fixed(SEAL));
    if (validators.includes(undefined) || seals.includes(undefined)) return undefined;
    const [vote, round] = [items[2], items[3].bytes];
    const protocol = protocolOf(vote, round);
    if (!protocol) return undefined;
    const found = new Committed();
    const number = round.reduce((sum, digit) => sum * 256 + digit, 0);
    return Object.assign(found, { header, items, validators, seals, protocol, round: number });
  }

  /** The header's hash with another round in its extra data, or without one, and without seals. */
  hash(round) {
    const parts = this.items.slice(0, 3).map((item) => item.source);
    if (round !== undefined && this.protocol === "QBFT") {
      const digits = round === 0 ? new Uint8Array(0) : numberBytes(round, Math.ceil(round.toString(16).length / 2));
      parts.push(encodeBytes(digits), encodeList([]));
    } else if (round !== undefined) {
      parts.push(encodeBytes(numberBytes(round, 4)));
    }
    return this.header.withExtra(encodeList(parts));
  }

  blockHash() {
    return this.hash(this.protocol === "QBFT" ? 0 : undefined);
  }

  /** All who sealed it, each once; broken if a seal does not fit or there are too few. `pinned` are written in hex. */
  sealers(pinned) {
    const signed = this.hash(this.round);
    const named = this.validators.map(hex);
    const found = [];
    for (const seal of this.seals) {
      const account = recovered(signed, seal);
      const sealer = account && hex(account);
      // Nothing distinguishes a stranger from an altered header if it names no validators.
      if (sealer === undefined || (named.length && !named.includes(sealer)))
        throw new Broken("a seal is of nobody it names");
      if (found.includes(sealer)) throw new Broken("one has sealed the header twice");
      found.push(sealer);
    }
    if (found.length < twoThirds(named.length)) throw new Broken("too few have sealed it");
    const isByStrangers = !named.length && this.seals.length && !found.some((one) => pinned.includes(one));
    if (isByStrangers && this.isOfAnotherRound(this.seals[0], pinned))
      throw new Broken("its seals are of another round");
    return found;
  }

  /** Whether one of these made the seal, in another round than the header's own. */
  isOfAnotherRound(seal, those) {
    for (let round = 0; round <= ROUNDS_TRIED; round++) {
      const account = round === this.round ? undefined : recovered(this.hash(round), seal);
      if (account && those.includes(hex(account))) return true;
    }
    return false;
  }
}

/** A missing vote is an empty list under QBFT and empty bytes under IBFT 2.0; a round is a number, or four bytes. */
function protocolOf(vote, round) {
  const isWithout = vote.isList && vote.items.length === 0;
  if (round[0] === 0) return round.length === 4 && !isWithout ? "IBFT 2.0" : undefined;
  return round.length <= 3 && vote.isList ? "QBFT" : undefined;
}

/** Which pinned signers sealed a block, or built on it, and what else is known of its seals. */
export function sealsOf(headers, first, pinned) {
  const header = headers.get(first);
  if (header.committed) return committedSeals(header.committed, pinned);
  const found = { pinned: new Set(), isStranger: false, isUnsigned: false };
  let parent;
  const most = pinned.length * 4 + 16;
  for (let number = first; number < first + BigInt(most); number++) {
    const next = headers.get(number);
    if (!next || (parent && !equal(next.parent, parent))) break;
    const sealer = next.sealer();
    if (sealer === undefined) {
      found.isUnsigned = parent === undefined;
      break;
    }
    if (!pinned.includes(hex(sealer))) {
      found.isStranger = true;
      break;
    }
    found.pinned.add(hex(sealer));
    if (found.pinned.size >= pinned.length) break;
    parent = next.hash;
  }
  return found;
}

function committedSeals(committed, pinned) {
  const found = { pinned: new Set(), isStranger: false, isUnsigned: false, protocol: committed.protocol };
  try {
    const sealers = committed.sealers(pinned);
    found.isStranger = sealers.some((sealer) => !pinned.includes(sealer));
    found.pinned = new Set(sealers.filter((sealer) => pinned.includes(sealer)));
  } catch (error) {
    if (!(error instanceof Broken)) throw error;
    found.isBroken = true;
  }
  return found;
}
