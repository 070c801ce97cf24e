// Level (b): the key was its owner's, or that of a device the owner had authorised, at the anchoring block. And who signed
// what is disclosed.

import { ascii, concat, equal, hex } from "./bytes.js";
import { PROVEN, REFUSED, Refused, UNPROVEN, Unproven, judged, level, ofState } from "./outcome.js";
import { PublicKey } from "./sm2.js";

const MOST_IDENTITIES = 16;

/** P_C of an identity in the bundle that proves to be this account's; undefined if there is none. `hash` is in hex. */
export function identityOf({ bundle, domain, once }, hash, owner) {
  return once(`identity ${hash} ${hex(owner)}`, () => {
    const bytes = bundle.identities.get(hash);
    if (!bytes) return undefined;
    const part = (begin, end) => bytes.subarray(begin, end);
    const [token, own, envelope, proof] = [part(0, 32), part(32, 96), part(96, 160), part(160, 224)];
    const [signing, other] = [PublicKey.of(own), PublicKey.of(envelope)];
    if (!signing || !other || equal(own, envelope)) return undefined;
    const message = concat(ascii("AuthROS/identity/1"), domain, owner, own, envelope, token);
    return signing.verify(message, proof) ? signing : undefined;
  });
}

/** The level as far as the state is trusted, and the key that the owner had registered. */
export function rightOf(check, header, anchored) {
  const { shownAt, block, time, account, keys, claimedKeys } = anchored;
  const place = [shownAt, block, time, hex(account), keys, claimedKeys].join(" ");
  return check.once(`right ${hex(header.owner)} ${hex(header.signer)} ${place}`, () => {
    let ownerKey;
    const found = judged(() => {
      ownerKey = registered(check, header, anchored);
      return entitled(header, anchored, ownerKey);
    });
    return { level: found, ownerKey };
  });
}

const shown = ({ storage }, find) => ofState("registration_missing", "registration_broken", () => find(storage));

function registered(check, { owner }, anchored) {
  const isOwn = anchored.keys !== undefined && equal(anchored.account, owner);
  const version = isOwn ? anchored.keys : anchored.claimedKeys;
  const keysOf = (number) => shown(anchored, (storage) => storage.keys(owner, number));
  const keys = keysOf(version);
  if (!keys) throw new Unproven("no_keys");
  // The contract notes the version with the owner's own anchor, but the keys may have changed later in that block.
  const after = version < (1n << 64n) - 1n ? keysOf(version + 1n) : undefined;
  if (keys.block > anchored.block || (after && after.block <= anchored.block)) throw new Unproven("keys_replaced");
  const key = identityOf(check, hex(keys.identity), owner);
  if (!key) throw new Unproven("identity_missing");
  const pinned = check.trust?.person(owner)?.key;
  if (pinned && !equal(pinned, key.id)) throw new Unproven("other_key");
  return key;
}

function entitled(header, anchored, key) {
  const { owner } = header;
  const isAtBlock = anchored.shownAt === anchored.block;
  if (!equal(key.id, header.signer)) expectLent(header, anchored);
  const isSuspended = shown(anchored, (storage) => storage.isSuspended(owner));
  // The contract lets no suspended account anchor, but the state is that after the block, in which the owner may have been
  // suspended later. A later state with a suspension does not show that it came after the block.
  if (isAtBlock && isSuspended) return level(REFUSED, "suspended");
  const isShown = isAtBlock || (!isSuspended && equal(anchored.account, owner));
  return isShown ? level(PROVEN) : level(UNPROVEN, "suspension_unknown");
}

function expectLent({ owner, signer }, anchored) {
  const { block, shownAt, time } = anchored;
  const loan = shown(anchored, (storage) => storage.loan(owner, signer));
  if (loan && loan.lent > block && shownAt > block) throw new Unproven("device_unknown");
  if (!loan || loan.lent > block) throw new Refused("no_right");
  if (loan.recalled !== 0n && loan.recalled <= block) throw new Refused("no_right");
  if (loan.until === 0n) return;
  if (time === undefined) throw new Unproven("device_unknown");
  if (time >= loan.until) throw new Refused("no_right");
}

/**
 * Who vouches for what is disclosed. An identity proves that its key signed it, not whose account it is: only the state or a
 * pin shows that.
 */
export function vouched(check, { owner }, ownerKey) {
  const { bundle, domain, trust, once } = check;
  const { list, signature } = bundle.disclosure;
  const verify = (key) => key.verify(concat(ascii("AuthROS/reveal/2"), domain, list), signature);
  const isSigned = (key) => key !== undefined && once(`disclosed ${hex(key.id)}`, () => verify(key));
  const pinned = trust?.person(owner)?.key;
  if (isSigned(ownerKey) || isSigned(pinned && bundle.keys.get(hex(pinned)))) return level(PROVEN);
  const identities = once("identities", () => [...bundle.identities.keys()].sort());
  const claims = () => identities.slice(0, MOST_IDENTITIES).some((hash) => isSigned(identityOf(check, hash, owner)));
  if (identities.length > MOST_IDENTITIES || claims()) return level(UNPROVEN, "unproven_disclosure");
  return level(REFUSED, "foreign_disclosure");
}
