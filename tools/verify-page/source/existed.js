// Level (d): an authority's time stamp over the root of a record's batch.

import { leads } from "./anchor.js";
import { hex, unhex } from "./bytes.js";
import { leadsTo, stampLeaf } from "./merkle.js";
import { ABSENT, Broken, PROVEN, REFUSED, UNPROVEN, level } from "./outcome.js";
import { checkToken } from "./stamp.js";

/** The last second that nanoseconds of 64 bits can tell. */
const LAST = 18_446_744_073;

const earlier = (one, other) => (one === undefined || other?.before < one.before ? other : one);

/** What the tokens of one stamp state: the earliest by a pinned authority, and whether one contradicts itself. */
async function findingOf(imprint, tokens, authorities) {
  const found = { isRefused: false };
  const pinned = authorities.map((authority) => authority.certificate);
  for (const token of tokens) {
    try {
      const stamped = await checkToken(token, imprint, pinned);
      const authority = authorities[stamped.pinned]?.name;
      if (authority !== undefined)
        found.proven = earlier(found.proven, { before: Math.min(stamped.before, LAST), authority });
    } catch (error) {
      if (!(error instanceof Broken)) throw error;
      found.isRefused = true;
    }
  }
  return found;
}

/** Stamps by the roots that they are over; each token is checked once. */
export async function stampsOf(bundle, trust) {
  const roots = new Map();
  for (const imprint of [...bundle.stamps.keys()].sort()) {
    const { listed, tokens } = bundle.stamps.get(imprint);
    const finding = await findingOf(unhex(imprint), tokens, trust?.authorities ?? []);
    for (const place of listed.roots) {
      const name = hex(place.root);
      roots.set(name, [...(roots.get(name) ?? []), { listed, place, finding }]);
    }
  }
  return roots;
}

/** The level, and before which second, according to whom, if an authority is pinned. */
export function existedLevel(stamps, record) {
  const anchor = record.anchor?.anchor;
  const found = anchor?.mode === "batch" ? stamps.get(hex(anchor.root)) : undefined;
  if (!found) return { level: level(ABSENT) };
  const isUnder = ({ listed, place }) =>
    leadsTo(listed.top, stampLeaf(place.root), place.index, listed.count, place.path);
  if (!leads(record, record.anchor) || !found.every(isUnder)) return { level: level(REFUSED, "stamp_path") };
  if (found.some(({ finding }) => finding.isRefused)) return { level: level(REFUSED, "bad_stamp") };
  const best = found.reduce((one, { finding }) => earlier(one, finding.proven), undefined);
  return best ? { level: level(PROVEN), ...best } : { level: level(UNPROVEN, "unknown_authority") };
}
