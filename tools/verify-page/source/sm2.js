// SM2 signatures (GB/T 32918.2) over the recommended curve of GB/T 32918.5, with the identifier 1234567812345678.

import { weierstrass } from "@noble/curves/abstract/weierstrass.js";
import { ascii, big, concat, equal, numberBytes, padded } from "./bytes.js";
import { Der } from "./der.js";
import { Broken } from "./outcome.js";
import { sm3 } from "./sm3.js";

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
const NAME = ascii("1234567812345678");
const PARAMETERS = concat(
  numberBytes(NAME.length * 8, 2),
  NAME,
  ...[CURVE.a, CURVE.b, CURVE.Gx, CURVE.Gy].map((number) => numberBytes(number, 32)),
);
const UNCOMPRESSED = Uint8Array.of(4);
/** Signatures of one key after which a table of its multiples pays, and the most such tables. */
const OFTEN = 16;
const MOST_TABLES = 32;
const WINDOW = 5;

/** SM3 of the uncompressed point: what names a key. */
export const signerId = (point) => sm3(UNCOMPRESSED, point);

/** A public key: x and y, 32 bytes each. */
export class PublicKey {
  static tables = 0;

  constructor(bytes, point) {
    this.bytes = bytes;
    this.point = point;
    this.id = signerId(bytes);
    this.z = sm3(PARAMETERS, bytes);
    this.used = 0;
  }

  /** Undefined if it is not a point on the curve. */
  static of(bytes) {
    try {
      const point = Point.fromBytes(concat(UNCOMPRESSED, bytes));
      point.assertValidity();
      return new PublicKey(bytes, point);
    } catch {
      return undefined;
    }
  }

  multiplied(s, t) {
    this.used += 1;
    if (this.used === OFTEN && PublicKey.tables < MOST_TABLES) {
      PublicKey.tables += 1;
      Point.BASE.precompute(WINDOW, false);
      this.point.precompute(WINDOW, false);
      this.isQuick = true;
    }
    if (!this.isQuick) return Point.BASE.mulAddUnsafe(s, this.point, t);
    return Point.BASE.multiplyUnsafe(s).add(this.point.multiplyUnsafe(t));
  }

  /** Whether `signature` (r and s, 32 bytes each) is of this key over the message. */
  verify(message, signature) {
    const { n } = CURVE;
    const [r, s] = [big(signature.subarray(0, 32)), big(signature.subarray(32))];
    const t = (r + s) % n;
    if (r === 0n || r >= n || s === 0n || s >= n || t === 0n) return false;
    const sum = this.multiplied(s, t);
    if (sum.is0()) return false;
    return (big(sm3(this.z, message)) + sum.toAffine().x) % n === r;
  }
}

/** r and s of a signature in DER, 32 bytes each. Their range is checked with the signature. */
export function signatureOfDer(bytes) {
  const part = "SM2 signature";
  const body = Der.only(part, bytes, 0x30);
  const number = () => {
    const digits = body.integer();
    const magnitude = digits[0] === 0 && digits.length > 1 ? digits.subarray(1) : digits;
    if (digits[0] & 0x80 || magnitude.length > 32) throw new Broken(`the ${part} has a number out of range`);
    return padded(magnitude);
  };
  const signature = concat(number(), number());
  body.end();
  return signature;
}

const INFO = "3059301306072a8648ce3d020106082a811ccf5501822d03420004";
const LINES = /^-----BEGIN PUBLIC KEY-----\n([A-Za-z0-9+/]{64})\n([A-Za-z0-9+/=]{60})\n-----END PUBLIC KEY-----\n$/;

/** A key in a bundle's one form of PEM: undefined if it is not that, or not a point. */
export function keyOfPem(pem) {
  const found = LINES.exec(pem ?? "");
  if (!found) return undefined;
  const base64 = found[1] + found[2];
  let bytes;
  try {
    bytes = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
  } catch {
    return undefined;
  }
  const info = bytes.subarray(0, bytes.length - 64);
  const isWhole = bytes.length === 91 && btoa(String.fromCharCode(...bytes)) === base64;
  if (!isWhole || !equal(info, numberBytes(BigInt("0x" + INFO), INFO.length / 2))) return undefined;
  return PublicKey.of(bytes.subarray(bytes.length - 64));
}
