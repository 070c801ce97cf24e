// JSON in one spelling: UTF-8, each name of an object once, whole numbers below 2^64; and the forms of a bundle's members.

import { addressBytes } from "./accounts.js";
import { text, unhex } from "./bytes.js";

const DEEPEST = 127;
const LARGEST = 1n << 64n;
const SPACE = /[ \t\r\n]*/y;
const PLAIN = /[^"\\\u0000-\u001f]*/y;
const WORD = /[0-9A-Za-z.+-]*/y;
/** Half of a character that takes two. */
const HALF = /\p{Cs}/u;
const ESCAPES = { '"': '"', "\\": "\\", "/": "/", b: "\b", f: "\f", n: "\n", r: "\r", t: "\t" };

class Parser {
  constructor(source) {
    this.source = source;
    this.at = 0;
  }

  /** What this sticky expression finds here. */
  run(expression) {
    expression.lastIndex = this.at;
    const [found] = expression.exec(this.source);
    this.at += found.length;
    return found;
  }

  space() {
    this.run(SPACE);
  }

  take(sign) {
    this.space();
    if (this.source[this.at] !== sign) return false;
    this.at++;
    return true;
  }

  expect(sign) {
    if (!this.take(sign)) throw new SyntaxError(`no ${sign} at ${this.at}`);
  }

  value(depth) {
    if (depth > DEEPEST) throw new SyntaxError("too deep");
    this.space();
    switch (this.source[this.at]) {
      case "{":
        return this.object(depth);
      case "[":
        return this.list(depth);
      case '"':
        return this.string();
      default:
        return this.other();
    }
  }

  object(depth) {
    const found = new Map();
    this.expect("{");
    if (this.take("}")) return found;
    do {
      this.space();
      const name = this.string();
      this.expect(":");
      if (found.has(name)) throw new SyntaxError("a name appears twice");
      found.set(name, this.value(depth + 1));
    } while (this.take(","));
    this.expect("}");
    return found;
  }

  list(depth) {
    const found = [];
    this.expect("[");
    if (this.take("]")) return found;
    do found.push(this.value(depth + 1));
    while (this.take(","));
    this.expect("]");
    return found;
  }

  string() {
    this.expect('"');
    let out = "";
    for (;;) {
      out += this.run(PLAIN);
      const sign = this.source[this.at++];
      if (sign === '"') break;
      if (sign !== "\\") throw new SyntaxError("a text does not end");
      out += this.escape();
    }
    if (HALF.test(out)) throw new SyntaxError("half a character");
    return out;
  }

  escape() {
    const sign = this.source[this.at++];
    if (sign !== "u") {
      if (!Object.hasOwn(ESCAPES, sign)) throw new SyntaxError("an unknown escape");
      return ESCAPES[sign];
    }
    const digits = this.source.slice(this.at, this.at + 4);
    if (!/^[0-9a-fA-F]{4}$/.test(digits)) throw new SyntaxError("an escape without its digits");
    this.at += 4;
    return String.fromCharCode(parseInt(digits, 16));
  }

  /** A whole number, true, false or null. */
  other() {
    const word = this.run(WORD);
    if (/^(0|[1-9][0-9]{0,19})$/.test(word) && BigInt(word) < LARGEST) return BigInt(word);
    const found = { true: true, false: false, null: null };
    if (!Object.hasOwn(found, word)) throw new SyntaxError(`'${word}' is not a value`);
    return found[word];
  }
}

/** Objects as maps, numbers as big integers. Throws `SyntaxError`. */
export function parse(bytes) {
  const source = text(bytes);
  if (source === undefined) throw new SyntaxError("not UTF-8");
  const parser = new Parser(source);
  const value = parser.value(0);
  parser.space();
  if (parser.at !== source.length) throw new SyntaxError("something follows");
  return value;
}

// Forms: each takes a value and returns what it means, or throws `SyntaxError`.

export function whole(value) {
  if (typeof value !== "bigint" || value < 0n || value >= LARGEST) throw new SyntaxError("not a whole number");
  return value;
}

export function string(value) {
  if (typeof value !== "string") throw new SyntaxError("not a text");
  return value;
}

/** Hex of the given number of bytes, with or without 0x. */
export const hash = (length) => (value) => {
  const digits = string(value).replace(/^0x/, "");
  const bytes = digits.length === 2 * length ? unhex(digits) : undefined;
  if (bytes === undefined) throw new SyntaxError(`not hex of ${length} bytes`);
  return bytes;
};

export function account(value) {
  const bytes = addressBytes(string(value));
  if (bytes === undefined) throw new SyntaxError("not an account");
  return bytes;
}

export const listOf = (form) => (value) => {
  if (!Array.isArray(value)) throw new SyntaxError("not a list");
  return value.map(form);
};

/** An object with exactly these lines; those in `optional` may be missing. */
export const lines =
  (required, optional = {}) =>
  (value) => {
    if (!(value instanceof Map)) throw new SyntaxError("not an object");
    const found = {};
    for (const [name, form] of Object.entries({ ...required, ...optional })) {
      if (value.has(name)) found[name] = form(value.get(name));
      else if (Object.hasOwn(required, name)) throw new SyntaxError(`no line ${name}`);
    }
    const other = [...value.keys()].find((name) => !Object.hasOwn(required, name) && !Object.hasOwn(optional, name));
    if (other !== undefined) throw new SyntaxError("an unknown line");
    return found;
  };
