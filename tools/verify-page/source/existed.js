// Level (d): an authority's time stamp over the root of a record's batch.

import { leads } from "./anchor.js";
import { hex, unhex } from "./bytes.js";
import { leadsTo, stampLeaf } from "./merkle.js";
import { ABSENT, Broken, PROVEN, REFUSED, UNPROVEN, level } from "./outcome.js";
import { checkToken } from "./stamp.js";

/** The last second that nanoseconds of 64 bits can tell. */
const LAST = 18_446_744_073;
/** Some browsers have no WebCrypto in pages that are opened from disk. */
const canCheck = () => globalThis.crypto?.subtle !== undefined;

const earlier = (one, other) => (one === undefined || other?.before < one.before ? other : one);

/** What the tokens of one stamp state: the earliest by a pinned authority, and whether one contradicts itself. */
async function findingOf(imprint, tokens, authorities) {
  const found = { isRefused: false };
  const pinned = authorities.map((authority) => authority.certificate);
  for (const token of canCheck() ? tokens : []) {
    try {
      const stamped = await checkToken(token, imprint, pinned);
      const authority = authorities[stamped.pinned]?.name;
      if (authority === undefined) continue;
      found.proven = earlier(found.proven, { before: Math.min(stamped.before, LAST), authority });
    } catch (error) {
      if (!(error instanceof Broken)) throw error;
      found.isRefused = true;
    }
  }
  return found;
}

/** What all stamps over each root come to together; each token is checked once, and each path. */
export async function stampsOf(bundle, trust) {
  const roots = new Map();
  for (const imprint of [...bundle.stamps.keys()].sort()) {
    const { listed, tokens } = bundle.stamps.get(imprint);
    const finding = await findingOf(unhex(imprint), tokens, trust?.authorities ?? []);
    for (const { root, index, path } of listed.roots) {
      const name = hex(root);
      if (!roots.has(name)) roots.set(name, { isAstray: false, isRefused: false, proven: undefined });
      const known = roots.get(name);
      known.isAstray ||= !leadsTo(listed.top, stampLeaf(root), index, listed.count, path);
      known.isRefused ||= finding.isRefused;
      known.proven = earlier(known.proven, finding.proven);
    }
  }
  return roots;
}

/** The level, and before which second, according to whom, if an authority is pinned. */
export function existedLevel(stamps, record) {
  const anchor = record.anchor?.anchor;
  const found = anchor?.mode === "batch" ? stamps.get(hex(anchor.root)) : undefined;
  if (!found) return { level: level(ABSENT) };
  if (!leads(record, record.anchor) || found.isAstray) return { level: level(REFUSED, "stamp_path") };
  if (!canCheck()) return { level: level(UNPROVEN, "not_checked") };
  if (found.isRefused) return { level: level(REFUSED, "bad_stamp") };
  return found.proven ? { level: level(PROVEN), ...found.proven } : { level: level(UNPROVEN, "unknown_authority") };
}
