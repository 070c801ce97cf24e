// Ethereum accounts: Keccak-256, addresses with their checksum (EIP-55), and who made a secp256k1 signature.

import { secp256k1 } from "@noble/curves/secp256k1.js";
import { keccak_256 } from "@noble/hashes/sha3.js";
import { ascii, concat, hex, unhex } from "./bytes.js";

export const keccak = (...parts) => keccak_256(parts.length === 1 ? parts[0] : concat(...parts));

const HALF = secp256k1.Point.Fn.ORDER >> 1n;
const PREHASHED = { prehash: false };

/** The account whose key made a seal (r, s, parity) over a hash; undefined if it is not a seal. */
export function recovered(hash, seal) {
  const parity = seal[64];
  const s = BigInt("0x" + hex(seal.subarray(32, 64)));
  if (parity > 1 || s > HALF) return undefined;
  try {
    const signature = concat(Uint8Array.of(parity), seal.subarray(0, 64));
    const compressed = secp256k1.recoverPublicKey(signature, hash, PREHASHED);
    const point = secp256k1.Point.fromBytes(compressed).toBytes(false);
    return keccak(point.subarray(1)).subarray(12);
  } catch {
    return undefined;
  }
}

const written = new Map();

/** An address with its checksum. */
export function address(bytes) {
  const small = hex(bytes);
  let found = written.get(small);
  if (!found) {
    const hash = hex(keccak(ascii(small)));
    const mixed = Array.from(small, (digit, at) => (hash[at] >= "8" ? digit.toUpperCase() : digit));
    found = "0x" + mixed.join("");
    if (written.size < 10_000) written.set(small, found);
  }
  return found;
}

/** The bytes of an address; undefined without 0x, or where capital letters among small ones are not its checksum. */
export function addressBytes(text) {
  const digits = /^0x([0-9a-fA-F]{40})$/.exec(text)?.[1];
  if (digits === undefined) return undefined;
  const bytes = unhex(digits);
  const isMixed = /[a-f]/.test(digits) && /[A-F]/.test(digits);
  return isMixed && address(bytes) !== text ? undefined : bytes;
}
