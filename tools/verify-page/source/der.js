// DER (X.690, 10 and 11), read strictly: definite and shortest lengths only, nothing left over.

import { Broken } from "./outcome.js";

export const BOOLEAN = 0x01;
export const INTEGER = 0x02;
export const BITS = 0x03;
export const OCTETS = 0x04;
export const NULL = 0x05;
export const OBJECT = 0x06;
export const UTC_TIME = 0x17;
export const GENERALIZED_TIME = 0x18;
export const SEQUENCE = 0x30;
export const SET = 0x31;
export const context = (number) => 0xa0 | number;
export const primitive = (number) => 0x80 | number;

/** Takes elements one after the other; `part` is its name in messages. */
export class Der {
  constructor(part, bytes) {
    this.part = part;
    this.bytes = bytes;
    this.at = 0;
  }

  /** Over the only element of `bytes`. */
  static only(part, bytes, tag) {
    const outer = new Der(part, bytes);
    const inner = outer.inside(tag);
    outer.end();
    return inner;
  }

  wrong(why) {
    return new Broken(`the ${this.part} is malformed: ${why}`);
  }

  isEmpty() {
    return this.at === this.bytes.length;
  }

  nextTag() {
    return this.bytes[this.at];
  }

  any() {
    const { bytes, at } = this;
    if (at + 2 > bytes.length) throw this.wrong("it ends too early");
    if ((bytes[at] & 0x1f) === 0x1f) throw this.wrong("it has a tag of several bytes");
    let [length, begin] = [bytes[at + 1], at + 2];
    if (length === 0x80 || length > 0x83) throw this.wrong("a length is indefinite or too large");
    if (length > 0x80) {
      const digits = bytes.subarray(begin, (begin += length & 0x7f));
      if (begin > bytes.length) throw this.wrong("it ends too early");
      length = digits.reduce((number, digit) => number * 256 + digit, 0);
      if (digits[0] === 0 || length < 0x80) throw this.wrong("a length is not in its shortest form");
    }
    const end = begin + length;
    if (end > bytes.length) throw this.wrong("it ends too early");
    this.at = end;
    return { tag: bytes[at], content: bytes.subarray(begin, end), whole: bytes.subarray(at, end) };
  }

  element(tag) {
    const element = this.any();
    if (element.tag !== tag) throw this.wrong("it has an element of the wrong type");
    return element;
  }

  optional(tag) {
    return this.nextTag() === tag ? this.any() : undefined;
  }

  inside(tag) {
    return new Der(this.part, this.element(tag).content);
  }

  insideOptional(tag) {
    const element = this.optional(tag);
    return element && new Der(this.part, element.content);
  }

  /** What `read` finds in the next element, all of which it reads. */
  within(tag, read) {
    const inner = this.inside(tag);
    const found = read(inner);
    inner.end();
    return found;
  }

  /** Two's complement, in the shortest form. */
  integer() {
    const bytes = this.element(INTEGER).content;
    const isPadded =
      bytes.length > 1 && ((bytes[0] === 0 && bytes[1] < 0x80) || (bytes[0] === 0xff && bytes[1] >= 0x80));
    if (!bytes.length || isPadded) throw this.wrong("an integer is not in its shortest form");
    return bytes;
  }

  small() {
    const number = smallNumber(this.integer());
    if (number === undefined) throw this.wrong("an integer is too large or negative");
    return number;
  }

  object() {
    return this.element(OBJECT).content;
  }

  bits() {
    const bytes = this.element(BITS).content;
    if (bytes[0] !== 0) throw this.wrong("a bit string is not a whole number of bytes");
    return bytes.subarray(1);
  }

  boolean() {
    const { content } = this.element(BOOLEAN);
    if (content.length !== 1 || (content[0] !== 0 && content[0] !== 0xff))
      throw this.wrong("a boolean is neither true nor false");
    return content[0] === 0xff;
  }

  end() {
    if (!this.isEmpty()) throw this.wrong("there is data left over");
  }
}

/** An integer's bytes as a number of at most five of them; undefined if negative or larger. */
export function smallNumber(bytes) {
  if (bytes[0] >= 0x80 || bytes.length > 5) return undefined;
  return bytes.reduce((number, byte) => number * 256 + byte, 0);
}
