// What a robot does, for tests: SM2 signatures, SM4-GCM and PEM by Node's OpenSSL and noble, not by the code under test.

import { createCipheriv, createHash, createHmac, randomBytes } from "node:crypto";
import { weierstrass } from "@noble/curves/abstract/weierstrass.js";

const CURVE = {
  p: 0xfffffffeffffffffffffffffffffffffffffffff00000000ffffffffffffffffn,
  n: 0xfffffffeffffffffffffffffffffffff7203df6b21c6052b53bbf40939d54123n,
  h: 1n,
  a: 0xfffffffeffffffffffffffffffffffffffffffff00000000fffffffffffffffcn,
  b: 0x28e9fa9e9d9f5e344d5a9e4bcf6509a7f39789f515ab8f92ddbcbd414d940e93n,
  Gx: 0x32c4ae2c1f1981195f9904466a39c9948fe30bbff2660be1715a4589334c74c7n,
  Gy: 0xbc3736a2f4f6779c59bdcee36b692153d0a9877cc62a474002df32e52139f0a0n,
};
const Point = weierstrass(CURVE);

export const sm3 = (...parts) => createHash("sm3").update(Buffer.concat(parts)).digest();
export const u64 = (number) => {
  const out = Buffer.alloc(8);
  out.writeBigUInt64BE(BigInt(number));
  return out;
};
const wide = (number) => Buffer.from(number.toString(16).padStart(64, "0"), "hex");
const whole = (bytes) => BigInt("0x" + Buffer.from(bytes).toString("hex"));

export class Key {
  constructor(secret = (whole(randomBytes(32)) % (CURVE.n - 2n)) + 1n) {
    this.secret = secret;
    this.public = Buffer.from(Point.BASE.multiply(secret).toBytes(false)).subarray(1);
    this.id = sm3(Buffer.of(4), this.public);
  }

  /** r and s, 32 bytes each (GB/T 32918.2). */
  sign(message, nonce = (whole(randomBytes(32)) % (CURVE.n - 1n)) + 1n) {
    const parameters = [CURVE.a, CURVE.b, CURVE.Gx, CURVE.Gy].map(wide);
    const z = sm3(Buffer.of(0, 128), Buffer.from("1234567812345678"), ...parameters, this.public);
    const e = whole(sm3(z, Buffer.from(message)));
    const { n } = CURVE;
    const r = (e + Point.BASE.multiply(nonce).toAffine().x) % n;
    const s = Point.Fn.create(Point.Fn.inv(1n + this.secret) * (nonce - r * this.secret));
    return Buffer.concat([wide(r), wide(s)]);
  }

  signDer(message) {
    const signature = this.sign(message);
    return der(0x30, ...[signature.subarray(0, 32), signature.subarray(32)].map(integer));
  }

  pem() {
    const info = Buffer.concat([
      Buffer.from("3059301306072a8648ce3d020106082a811ccf5501822d03420004", "hex"),
      this.public,
    ]);
    const text = info.toString("base64");
    return Buffer.from(
      `-----BEGIN PUBLIC KEY-----\n${text.slice(0, 64)}\n${text.slice(64)}\n-----END PUBLIC KEY-----\n`,
    );
  }
}

export function der(tag, ...parts) {
  const content = Buffer.concat(parts);
  const { length } = content;
  const digits = length < 128 ? [length] : length < 256 ? [0x81, length] : [0x82, length >> 8, length & 255];
  return Buffer.concat([Buffer.of(tag, ...digits), content]);
}

function integer(bytes) {
  const at = Math.min(bytes.findIndex((byte) => byte !== 0) >>> 0, bytes.length - 1);
  const magnitude = bytes.subarray(at);
  return der(2, magnitude[0] & 0x80 ? Buffer.concat([Buffer.of(0), magnitude]) : magnitude);
}

/** GHASH by the definition of NIST SP 800-38D, bit by bit. */
function ghash(h, data) {
  let y = 0n;
  for (let at = 0; at < data.length; at += 16) {
    const x = y ^ whole(data.subarray(at, at + 16));
    let [v, product] = [h, 0n];
    for (let bit = 127n; bit >= 0n; bit--) {
      if ((x >> bit) & 1n) product ^= v;
      v = v & 1n ? (v >> 1n) ^ (0xe1n << 120n) : v >> 1n;
    }
    y = product;
  }
  return y;
}

export function gcmSeal(key, nonce, aad, text) {
  const once = (block) => createCipheriv("sm4-ecb", key, null).setAutoPadding(false).update(block);
  const counter = (number) => Buffer.concat([nonce, Buffer.of(0, 0, 0, number)]);
  const sealed = createCipheriv("sm4-ctr", key, counter(2)).update(text);
  const padded = (bytes) => Buffer.concat([bytes, Buffer.alloc((16 - (bytes.length % 16)) % 16)]);
  const data = Buffer.concat([padded(aad), padded(sealed), u64(aad.length * 8), u64(sealed.length * 8)]);
  const tag = ghash(whole(once(Buffer.alloc(16))), data) ^ whole(once(counter(1)));
  return Buffer.concat([sealed, Buffer.from(tag.toString(16).padStart(32, "0"), "hex")]);
}

export function expand(key, info, length) {
  let [out, block] = [Buffer.alloc(0), Buffer.alloc(0)];
  for (let number = 1; out.length < length; number++) {
    block = createHmac("sm3", key)
      .update(Buffer.concat([block, info, Buffer.of(number)]))
      .digest();
    out = Buffer.concat([out, block]);
  }
  return out.subarray(0, length);
}
