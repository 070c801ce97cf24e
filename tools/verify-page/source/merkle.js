// RFC 6962's tree with SM3 (docs/format.md, section 6).

import { ascii, equal, numberBytes } from "./bytes.js";
import { sm3 } from "./sm3.js";

const LEAF = Uint8Array.of(0);
const NODE = Uint8Array.of(1);
export const LONGEST_PATH = 14;
export const MOST_LEAVES = 16_384;

export const recordLeaf = (header, digest) =>
  sm3(LEAF, header.owner, header.signer, header.recorder, header.topicId, numberBytes(header.seq, 8), digest);

export const heightLeaf = (topic, number) => sm3(LEAF, ascii("AuthROS/height/1"), topic, numberBytes(number, 8));

export const stampLeaf = (root) => sm3(LEAF, ascii("AuthROS/stamp/1"), root);

/** Whether a path leads from a leaf to the root of a tree of `count` leaves (RFC 9162, 2.1.3.2). */
export function leadsTo(root, leaf, index, count, path) {
  if (index >= count || path.length > LONGEST_PATH) return false;
  let [place, last, hash] = [index, count - 1n, leaf];
  for (const sibling of path) {
    if (last === 0n) return false;
    if (place & 1n || place === last) {
      hash = sm3(NODE, sibling, hash);
      while (!(place & 1n) && place !== 0n) [place, last] = [place >> 1n, last >> 1n];
    } else {
      hash = sm3(NODE, hash, sibling);
    }
    [place, last] = [place >> 1n, last >> 1n];
  }
  return last === 0n && equal(hash, root);
}
