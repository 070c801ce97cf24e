// Bytes, hex and text, and a reader that never runs past the end.

import { Broken } from "./outcome.js";

const DECODER = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
const ENCODER = new TextEncoder();
const HEX = Array.from({ length: 256 }, (_, byte) => byte.toString(16).padStart(2, "0"));

export const ascii = (text) => ENCODER.encode(text);

/** Text of UTF-8, or undefined. */
export function text(bytes) {
  try {
    return DECODER.decode(bytes);
  } catch {
    return undefined;
  }
}

export function hex(bytes) {
  let out = "";
  for (const byte of bytes) out += HEX[byte];
  return out;
}

/** Bytes of hex digits without a prefix; undefined if they are not. */
export function unhex(digits) {
  if (digits.length % 2 || !/^[0-9a-fA-F]*$/.test(digits)) return undefined;
  return Uint8Array.from({ length: digits.length / 2 }, (_, at) => parseInt(digits.slice(2 * at, 2 * at + 2), 16));
}

export function concat(...parts) {
  const out = new Uint8Array(parts.reduce((length, part) => length + part.length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

export function equal(one, other) {
  if (one.length !== other.length) return false;
  for (let at = 0; at < one.length; at++) if (one[at] !== other[at]) return false;
  return true;
}

export const startsWith = (bytes, prefix) =>
  bytes.length >= prefix.length && equal(bytes.subarray(0, prefix.length), prefix);

export const isZero = (bytes) => bytes.every((byte) => byte === 0);

/** A big-endian number of any length. */
export const big = (bytes) => (bytes.length ? BigInt("0x" + hex(bytes)) : 0n);

/** A number, big endian, in the given number of bytes. */
export const numberBytes = (number, length) =>
  unhex(
    BigInt(number)
      .toString(16)
      .padStart(2 * length, "0"),
  );

export function padded(bytes, length = 32) {
  const out = new Uint8Array(length);
  out.set(bytes, length - bytes.length);
  return out;
}

export class Reader {
  constructor(bytes) {
    this.bytes = bytes;
    this.at = 0;
  }

  take(length, field) {
    if (length > this.bytes.length - this.at) throw new Broken(`the data ends before the ${field}`);
    this.at += length;
    return this.bytes.subarray(this.at - length, this.at);
  }

  number(length, field) {
    return big(this.take(length, field));
  }

  small(length, field) {
    return Number(this.number(length, field));
  }

  /** Text behind its length of two bytes. */
  word(field) {
    const found = text(this.take(this.small(2, field), field));
    if (found === undefined) throw new Broken(`the ${field} is not text`);
    return found;
  }

  rest() {
    return this.bytes.subarray(this.at);
  }
}
