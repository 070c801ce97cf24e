// Level (c): the state after a block contains the record's digest or its batch's root, and pinned signers sealed the block.

import { equal } from "./bytes.js";
import { sealsOf } from "./header.js";
import { leadsTo, recordLeaf } from "./merkle.js";
import { OWN_CHAIN, PROVEN, REFUSED, Refused, UNPROVEN, Unproven, level, ofState } from "./outcome.js";
import { Storage } from "./state.js";

const inAnchor = (find) => ofState("state_missing", "state_broken", find);

/** Where a record is anchored, as the state of a block in the bundle has it. Throws the level if it is not. */
export function findAnchor(check, record) {
  const claim = record.anchor;
  if (!claim) throw new Unproven("not_anchored");
  if (!leads(record, claim)) throw new Refused("wrong_path");
  const shownAt = check.bundle.headers.get(claim.shown_at);
  if (!shownAt) throw new Unproven("header_missing");
  const storage = storageOf(check, shownAt);
  const anchored = inAnchor(() => inState(storage, record, shownAt));
  if (!anchored) throw new Refused("anchor_missing");
  compare(anchored, claim, shownAt);
  return { ...anchored, storage, header: shownAt, shownAt: shownAt.number, claimedKeys: claim.keys };
}

export function leads(record, { anchor }) {
  if (anchor.mode === "each") return true;
  const leaf = recordLeaf(record.header, record.digest);
  return leadsTo(anchor.root, leaf, anchor.index, anchor.count, anchor.path);
}

function storageOf({ bundle, contract, trust, once }, shownAt) {
  const make = () => inAnchor(() => new Storage(bundle.nodes, shownAt.stateRoot, contract));
  const storage = once(`storage ${shownAt.number}`, make);
  if (trust && !equal(trust.chain.code_hash, storage.codeHash)) throw new Refused("other_code");
  return storage;
}

function inState(storage, { header, digest, anchor: { anchor } }, shownAt) {
  if (anchor.mode === "each") {
    const block = storage.uploaded(header.owner, digest);
    // The contract stores no time of a digest: it is known if the block is the one whose state this is.
    const time = block === shownAt.number ? shownAt.timestamp : undefined;
    return block && { block, time, account: header.owner };
  }
  const word = storage.anchor(anchor.account, anchor.root);
  // The contract never stores a time of zero: a word without one shows none.
  return word && { ...word, time: word.time || undefined, account: anchor.account };
}

function compare(found, claim, shownAt) {
  if (found.count !== claim.anchor.count) throw new Refused("other_anchor");
  // The contract stores only a root's first block. A batch of one whose block was skipped has no other root.
  if (found.block < claim.block && found.count === 1n) throw new Unproven("first_block_only");
  const isLater = found.block > shownAt.number || (found.time !== undefined && found.time > shownAt.timestamp);
  if (found.block !== claim.block || isLater) throw new Refused("other_anchor");
}

/** Whether pinned signers sealed the block whose state shows an anchor. */
export function sealedLevel({ bundle, trust, once }, { header, shownAt }) {
  if (!trust) return level(UNPROVEN, "no_trust");
  const { signers } = trust;
  const found = once(`seals ${shownAt}`, () => sealsOf(bundle.headers, shownAt, signers));
  const needed = found.protocol ? trust.commitQuorum() : trust.quorum();
  if (found.pinned.size < needed) return tooFew(found, signers.length);
  return level(trust.chain.sealed_by_exporter || header.isOurs() ? OWN_CHAIN : PROVEN);
}

function tooFew(found, pinned) {
  if (found.isBroken) return level(REFUSED, "broken_seals");
  if (pinned === 0 && !found.isUnsigned) return level(UNPROVEN, "no_signers");
  if (found.isStranger && found.pinned.size === 0) return level(REFUSED, "other_signer");
  return level(UNPROVEN, found.isUnsigned ? "no_seal" : "few_signers");
}
