// SM4 (GB/T 32907) in GCM (NIST SP 800-38D, RFC 8998), for what is disclosed.

const SBOX = sbox();
const TABLES = tables();
const FAMILY = [0xa3b1bac6, 0x56aa3350, 0x677d9197, 0xb27022dc];
const TAG = 16;

/** Affine, inversion modulo x^8 + x^7 + x^6 + x^5 + x^4 + x^2 + 1, affine. */
function sbox() {
  const times = (a, b) => {
    let product = 0;
    for (; b; b >>= 1, a = (a << 1) ^ (a & 0x80 ? 0x1f5 : 0)) if (b & 1) product ^= a;
    return product;
  };
  const isOdd = (byte) => byte.toString(2).replaceAll("0", "").length & 1;
  const affine = (x) => {
    let out = 0xd3;
    for (let at = 0; at < 8; at++) out ^= isOdd(x & ((0xd3 >> at) | ((0xd3 << (8 - at)) & 0xff))) << (7 - at);
    return out;
  };
  const inverse = new Uint8Array(256);
  for (let a = 1; a < 256; a++) for (let b = 1; b < 256; b++) if (times(a, b) === 1) inverse[a] = b;
  return Uint8Array.from({ length: 256 }, (_, x) => affine(inverse[affine(x)]));
}

function rotated(word, by) {
  return (word << by) | (word >>> (32 - by));
}

/** The S-box and the linear step of a round together, for each byte of a word. */
function tables() {
  const linear = (word) => word ^ rotated(word, 2) ^ rotated(word, 10) ^ rotated(word, 18) ^ rotated(word, 24);
  return [24, 16, 8, 0].map((shift) => Int32Array.from(SBOX, (byte) => linear(byte << shift)));
}

function roundKeys(key) {
  const view = new DataView(key.buffer, key.byteOffset, 16);
  const k = FAMILY.map((word, at) => view.getUint32(4 * at) ^ word);
  const keys = new Int32Array(32);
  for (let i = 0; i < 32; i++) {
    let constant = 0;
    for (let j = 0; j < 4; j++) constant = (constant << 8) | (((4 * i + j) * 7) & 0xff);
    const x = k[i + 1] ^ k[i + 2] ^ k[i + 3] ^ constant;
    const b = (SBOX[x >>> 24] << 24) | (SBOX[(x >>> 16) & 255] << 16) | (SBOX[(x >>> 8) & 255] << 8) | SBOX[x & 255];
    keys[i] = k[i] ^ b ^ rotated(b, 13) ^ rotated(b, 23);
    k.push(keys[i]);
  }
  return keys;
}

/** Four words in, four words out. */
function encrypt(keys, input, output) {
  const [t0, t1, t2, t3] = TABLES;
  let [a, b, c, d] = input;
  for (let i = 0; i < 32; i++) {
    const x = b ^ c ^ d ^ keys[i];
    const next = a ^ t0[x >>> 24] ^ t1[(x >>> 16) & 255] ^ t2[(x >>> 8) & 255] ^ t3[x & 255];
    a = b;
    b = c;
    c = d;
    d = next;
  }
  output[0] = d;
  output[1] = c;
  output[2] = b;
  output[3] = a;
}

/** Multiplies by H a byte at a time: products of H with each byte, and what falls off the end of a shift by eight bits. */
class Ghash {
  constructor(h) {
    this.products = new Int32Array(1024);
    this.y = new Int32Array(4);
    let [a, b, c, d] = h;
    for (let bit = 128; bit > 0; bit >>= 1) {
      this.products.set([a, b, c, d], bit * 4);
      const carry = d & 1;
      d = (d >>> 1) | (c << 31);
      c = (c >>> 1) | (b << 31);
      b = (b >>> 1) | (a << 31);
      a = (a >>> 1) ^ (carry ? 0xe1000000 : 0);
    }
    for (let byte = 2; byte < 256; byte <<= 1) {
      for (let below = 1; below < byte; below++) {
        for (let at = 0; at < 4; at++) {
          this.products[(byte + below) * 4 + at] = this.products[byte * 4 + at] ^ this.products[below * 4 + at];
        }
      }
    }
  }

  word(bytes, at) {
    return (bytes[at] << 24) | (bytes[at + 1] << 16) | (bytes[at + 2] << 8) | bytes[at + 3];
  }

  block(a, b, c, d) {
    const { y, products } = this;
    const x = [y[0] ^ a, y[1] ^ b, y[2] ^ c, y[3] ^ d];
    let p = 0;
    let q = 0;
    let r = 0;
    let s = 0;
    for (let at = 15; at >= 0; at--) {
      const fallen = REDUCTION[s & 255];
      s = (s >>> 8) | (r << 24);
      r = (r >>> 8) | (q << 24);
      q = (q >>> 8) | (p << 24);
      p = (p >>> 8) ^ (fallen << 16);
      const byte = ((x[at >> 2] >>> (24 - 8 * (at & 3))) & 255) * 4;
      p ^= products[byte];
      q ^= products[byte + 1];
      r ^= products[byte + 2];
      s ^= products[byte + 3];
    }
    y[0] = p;
    y[1] = q;
    y[2] = r;
    y[3] = s;
  }

  update(bytes) {
    let at = 0;
    for (; at + 16 <= bytes.length; at += 16) {
      this.block(this.word(bytes, at), this.word(bytes, at + 4), this.word(bytes, at + 8), this.word(bytes, at + 12));
    }
    if (at < bytes.length) {
      const last = new Uint8Array(16);
      last.set(bytes.subarray(at));
      this.update(last);
    }
  }

  lengths(one, other) {
    this.block(Math.floor(one / 0x20000000), (one * 8) | 0, Math.floor(other / 0x20000000), (other * 8) | 0);
  }
}

const REDUCTION = Int32Array.from({ length: 256 }, (_, byte) => {
  let out = 0;
  for (let bit = 0; bit < 8; bit++) if (byte & (1 << bit)) out ^= 0xe100 >> (7 - bit);
  return out;
});

/** The text of what is sealed, tag last; undefined if the tag does not hold. */
export function gcmOpen(key, nonce, aad, sealed) {
  if (sealed.length < TAG) return undefined;
  const keys = roundKeys(key);
  const masked = sealed.subarray(0, sealed.length - TAG);
  const tag = sealed.subarray(sealed.length - TAG);
  const block = new Int32Array(4);
  encrypt(keys, block, block);
  const hash = new Ghash(block);
  hash.update(aad);
  hash.update(masked);
  hash.lengths(aad.length, masked.length);
  const counter = Int32Array.from([hash.word(nonce, 0), hash.word(nonce, 4), hash.word(nonce, 8), 1]);
  encrypt(keys, counter, block);
  let differs = 0;
  for (let at = 0; at < 4; at++) differs |= hash.word(tag, 4 * at) ^ block[at] ^ hash.y[at];
  if (differs) return undefined;
  const out = new Uint8Array(masked.length);
  for (let at = 0; at < masked.length; at += 16) {
    counter[3]++;
    encrypt(keys, counter, block);
    const end = Math.min(at + 16, masked.length);
    for (let byte = at; byte < end; byte++) {
      out[byte] = masked[byte] ^ (block[(byte - at) >> 2] >>> (24 - 8 * ((byte - at) & 3)));
    }
  }
  return out;
}
