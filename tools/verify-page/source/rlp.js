// RLP (Yellow Paper, appendix B) in its one form: each length in its shortest form, lists at most 32 deep.

import { concat } from "./bytes.js";

const DEEPEST = 32;

/** An item: bytes, or a list of items; each with its source. */
class Item {
  constructor(bytes, items, source) {
    this.bytes = bytes;
    this.items = items;
    this.source = source;
  }

  get isList() {
    return this.items !== undefined;
  }

  /** Bytes of this length; undefined if it is a list or another length. */
  fixed(length) {
    return this.bytes?.length === length ? this.bytes : undefined;
  }

  /** A number of at most 64 bits without leading zeros, or undefined. */
  number() {
    const { bytes } = this;
    if (bytes === undefined || bytes.length > 8 || bytes[0] === 0) return undefined;
    return bytes.reduce((number, byte) => number * 256n + BigInt(byte), 0n);
  }
}

function read(data, at, depth) {
  if (at >= data.length) return undefined;
  const first = data[at];
  if (first < 0x80) return new Item(data.subarray(at, at + 1), undefined, data.subarray(at, at + 1));
  const base = first < 0xc0 ? 0x80 : 0xc0;
  let begin = at + 1;
  let length = first - base;
  if (length > 55) {
    const digits = data.subarray(begin, begin + length - 55);
    begin += length - 55;
    length = digits.reduce((number, digit) => number * 256 + digit, 0);
    if (begin > data.length || digits[0] === 0 || length < 56) return undefined;
  }
  const end = begin + length;
  if (end > data.length) return undefined;
  const content = data.subarray(begin, end);
  const source = data.subarray(at, end);
  if (base === 0x80) return length === 1 && content[0] < 0x80 ? undefined : new Item(content, undefined, source);
  const items = [];
  for (let inner = begin; inner < end;) {
    const item = depth < DEEPEST ? read(data.subarray(0, end), inner, depth + 1) : undefined;
    if (item === undefined) return undefined;
    items.push(item);
    inner += item.source.length;
  }
  return new Item(undefined, items, source);
}

/** The only item of these bytes, or undefined. */
export function decode(data) {
  const item = read(data, 0, 0);
  return item && item.source.length === data.length ? item : undefined;
}

function header(base, length) {
  if (length < 56) return Uint8Array.of(base + length);
  const digits = [];
  for (let rest = length; rest > 0; rest = Math.floor(rest / 256)) digits.unshift(rest & 255);
  return Uint8Array.of(base + 55 + digits.length, ...digits);
}

export function encodeBytes(bytes) {
  return bytes.length === 1 && bytes[0] < 0x80 ? bytes : concat(header(0x80, bytes.length), bytes);
}

/** A list of items that are encoded. */
export function encodeList(items) {
  const length = items.reduce((sum, item) => sum + item.length, 0);
  return concat(header(0xc0, length), ...items);
}
