// Certificates (X.509) as far as time stamp authorities need them. WebCrypto checks RSA and ECDSA.

import { sha256, sha384, sha512 } from "@noble/hashes/sha2.js";
import { equal, hex, isZero } from "./bytes.js";
import {
  BITS,
  BOOLEAN,
  Der,
  NULL,
  OCTETS,
  SEQUENCE,
  SET,
  context,
  primitive,
  UTC_TIME,
  GENERALIZED_TIME,
} from "./der.js";
import { clean } from "./display.js";
import { Broken } from "./outcome.js";

const PART = "certificate";
const BAD = "its signature is invalid";
export const LONGEST_DER = 65_536;

/** Contents of object identifiers, in hex. */
export const OID = {
  signedData: "2a864886f70d010702",
  stamp: "2a864886f70d0109100104",
  contentType: "2a864886f70d010903",
  messageDigest: "2a864886f70d010904",
  signingCertificate: "2a864886f70d010910020c",
  signingCertificate2: "2a864886f70d010910022f",
};
const HASHES = {
  "608648016503040201": { name: "SHA-256", of: sha256, length: 32 },
  "608648016503040202": { name: "SHA-384", of: sha384, length: 48 },
  "608648016503040203": { name: "SHA-512", of: sha512, length: 64 },
};
export const SHA_256 = HASHES["608648016503040201"];
const [SHA_384, SHA_512] = [HASHES["608648016503040202"], HASHES["608648016503040203"]];
const RSA = "2a864886f70d010101";
const RSA_PSS = "2a864886f70d01010a";
const MASK = "2a864886f70d010108";
const CURVE_KEY = "2a8648ce3d0201";
const CURVES = { "2a8648ce3d030107": { name: "P-256", size: 32 }, "2b81040022": { name: "P-384", size: 48 } };
const SCHEMES = {
  [RSA]: { kind: "rsa" },
  "2a864886f70d01010b": { kind: "pkcs1", hash: SHA_256 },
  "2a864886f70d01010c": { kind: "pkcs1", hash: SHA_384 },
  "2a864886f70d01010d": { kind: "pkcs1", hash: SHA_512 },
  "2a8648ce3d040302": { kind: "ecdsa", hash: SHA_256 },
  "2a8648ce3d040303": { kind: "ecdsa", hash: SHA_384 },
  "2a8648ce3d040304": { kind: "ecdsa", hash: SHA_512 },
};
const KEY_USAGE = "551d0f";
const BASIC_CONSTRAINTS = "551d13";
const POLICIES = "551d20";
const EXTENDED_KEY_USAGE = "551d25";
const TIME_STAMPING = "2b06010505070308";
const COMMON_NAME = "550403";
const MAY_SIGN_CERTIFICATES = 0x04;
const MAY_SIGN = 0xc0;

const form = (part, why) => new Broken(`the ${part} is malformed: ${why}`);
/** Not checked here, which is an error only once it is asked for. */
class UnknownAlgorithm extends Broken {}
export const algorithm = (name) => new UnknownAlgorithm(`it is signed with ${name}`);

/** The only sequence of a text that is not too long. */
export function outer(part, bytes) {
  if (bytes.length > LONGEST_DER) throw form(part, "it is too long");
  return Der.only(part, bytes, SEQUENCE);
}

/** Seconds since 1970; fractions rounded up or down. */
export function seconds(element, part, up) {
  const digits = element.tag === UTC_TIME ? "([0-9]{2})" : "([0-9]{4})";
  const expression = new RegExp(`^${digits}([0-9]{2})([0-9]{2})([0-9]{2})([0-9]{2})([0-9]{2})(\\.[0-9]{0,8}[1-9])?Z$`);
  const found = expression.exec(String.fromCharCode(...element.content));
  if (![UTC_TIME, GENERALIZED_TIME].includes(element.tag) || !found) throw form(part, "a time is not valid");
  const [year, month, day, hour, minute, second] = found.slice(1, 7).map(Number);
  const isFractional = found[7] !== undefined;
  // RFC 5280, 4.1.2.5.1.
  const full = element.tag === UTC_TIME ? year + (year < 50 ? 2000 : 1900) : year;
  const moment = new Date(0);
  moment.setUTCFullYear(full, month - 1, day);
  moment.setUTCHours(hour, minute, second);
  const isReal =
    moment.getUTCMonth() === month - 1 && moment.getUTCDate() === day && hour < 24 && minute < 60 && second < 60;
  const at = moment.getTime() / 1000;
  if (!isReal || at < 0 || (isFractional && element.tag === UTC_TIME)) throw form(part, "a time is not valid");
  return at + (isFractional && up ? 1 : 0);
}

function nothing(der) {
  const found = der.optional(NULL);
  if (found?.content.length) throw der.wrong("NULL is not empty");
  der.end();
}

/** A hash in an AlgorithmIdentifier: nothing or NULL after the name. */
export function hashOf(der) {
  const inner = der.inside(SEQUENCE);
  const hash = HASHES[hex(inner.object())];
  if (!hash) throw algorithm("a hash other than SHA-256, -384 or -512");
  nothing(inner);
  return hash;
}

export function readScheme(der) {
  const inner = der.inside(SEQUENCE);
  const name = hex(inner.object());
  if (name === RSA_PSS) return pss(inner);
  nothing(inner);
  if (!Object.hasOwn(SCHEMES, name)) throw algorithm("an algorithm other than RSA or ECDSA with SHA-256, -384 or -512");
  return SCHEMES[name];
}

/** RFC 4055, 3.1: the same hash twice, and a salt of the same length. */
function pss(der) {
  const other = algorithm("RSA-PSS with parameters other than a single hash and a salt of its length");
  const required = (from, number) => {
    const found = from.insideOptional(context(number));
    if (!found) throw other;
    return found;
  };
  const inner = der.inside(SEQUENCE);
  der.end();
  const outside = required(inner, 0);
  const hash = hashOf(outside);
  outside.end();
  const mask = required(inner, 1);
  const generator = mask.inside(SEQUENCE);
  mask.end();
  const isKnown = hex(generator.object()) === MASK;
  const isSame = hashOf(generator) === hash;
  generator.end();
  const salt = required(inner, 2);
  const fits = salt.small() === hash.length;
  salt.end();
  const trailer = inner.insideOptional(context(3));
  if (trailer) {
    if (trailer.small() !== 1) throw other;
    trailer.end();
  }
  inner.end();
  if (!isKnown || !isSame || !fits) throw other;
  return { kind: "pss", hash };
}

/** With the hash that the signer names; undefined if the two contradict each other. */
export function withHash(scheme, hash) {
  if (scheme.kind === "rsa") return { kind: "pkcs1", hash };
  return scheme.hash === hash ? scheme : undefined;
}

function readKey(der) {
  const info = der.inside(SEQUENCE);
  const about = info.inside(SEQUENCE);
  const name = hex(about.object());
  const curve = name === CURVE_KEY ? CURVES[hex(about.any().content)] : undefined;
  const bytes = info.bits();
  info.end();
  if (name === RSA || name === RSA_PSS) return { kind: "rsa", bytes, isPss: name === RSA_PSS };
  return curve ? { kind: "ec", bytes, curve } : { kind: "other" };
}

const base64url = (bytes) =>
  btoa(String.fromCharCode(...bytes))
    .replaceAll("+", "-")
    .replaceAll("/", "_")
    .replace(/=+$/, "");

/** Modulus and exponent, from 2,048 to 8,192 bits, the exponent odd and at least 3. */
function rsaParts(bytes) {
  const inner = Der.only("key", bytes, SEQUENCE);
  const positive = () => {
    const digits = inner.integer();
    if (digits[0] & 0x80) throw new Broken(BAD);
    return digits[0] === 0 ? digits.subarray(1) : digits;
  };
  const [n, e] = [positive(), positive()];
  inner.end();
  const bits = n.length * 8 - Math.clz32(n[0]) + 24;
  const isSmall = e.length === 1 && e[0] < 3;
  if (!n.length || bits < 2048 || bits > 8192 || !e.length || e.length > 5 || !(e[e.length - 1] & 1) || isSmall) {
    throw new Broken(BAD);
  }
  return { n, e };
}

/** r and s behind one another, as WebCrypto takes them. */
function rawSignature(signature, size) {
  const body = Der.only("signature", signature, SEQUENCE);
  const out = new Uint8Array(2 * size);
  for (const end of [size, 2 * size]) {
    const digits = body.integer();
    const magnitude = digits[0] === 0 ? digits.subarray(1) : digits;
    if (digits[0] & 0x80 || isZero(digits) || magnitude.length > size) throw new Broken(BAD);
    out.set(magnitude, end - magnitude.length);
  }
  body.end();
  return out;
}

async function isSigned(key, scheme, message, signature) {
  const { subtle } = globalThis.crypto;
  if (key.kind === "rsa") {
    const { n, e } = rsaParts(key.bytes);
    const name = scheme.kind === "pss" ? "RSA-PSS" : "RSASSA-PKCS1-v1_5";
    const jwk = { kty: "RSA", n: base64url(n), e: base64url(e) };
    const imported = await subtle.importKey("jwk", jwk, { name, hash: scheme.hash.name }, false, ["verify"]);
    return subtle.verify({ name, saltLength: scheme.hash.length }, imported, signature, message);
  }
  const { name, size } = key.curve;
  if (key.bytes[0] !== 4) return false;
  const imported = await subtle.importKey("raw", key.bytes, { name: "ECDSA", namedCurve: name }, false, ["verify"]);
  return subtle.verify({ name: "ECDSA", hash: scheme.hash.name }, imported, rawSignature(signature, size), message);
}

/** Broken unless the key signed the message in this way. */
export async function verifyBy(key, scheme, message, signature) {
  if (scheme.kind === "ecdsa" && scheme.hash === SHA_512) throw algorithm("ECDSA with SHA-512");
  if (key.kind === "other") throw algorithm("a key that is neither RSA nor on P-256 or P-384");
  const isPkcs1 = scheme.kind === "pkcs1" && key.kind === "rsa" && !key.isPss;
  const fits =
    isPkcs1 || (scheme.kind === "pss" && key.kind === "rsa") || (scheme.kind === "ecdsa" && key.kind === "ec");
  if (!fits) throw form("signature", "its algorithm does not fit its key");
  // A key or signature out of its bounds verifies nothing; what WebCrypto throws over one says no more.
  const good = await isSigned(key, scheme, message, signature).catch(() => false);
  if (!good) throw new Broken(BAD);
}

class Uses {
  issuer = undefined;
  key = undefined;
  stamps = false;
  unknown = false;

  take(name, isCritical, value) {
    if (name === BASIC_CONSTRAINTS) {
      const inner = Der.only(PART, value, SEQUENCE);
      const issues = inner.nextTag() === BOOLEAN && inner.boolean();
      const most = inner.isEmpty() ? Infinity : inner.small();
      inner.end();
      this.issuer = issues ? most : undefined;
    } else if (name === KEY_USAGE) {
      const outside = new Der(PART, value);
      const bits = outside.element(BITS).content;
      outside.end();
      this.key = bits[1] ?? 0;
    } else if (name === EXTENDED_KEY_USAGE) {
      const inner = Der.only(PART, value, SEQUENCE);
      const first = hex(inner.object());
      this.stamps = isCritical && first === TIME_STAMPING && inner.isEmpty();
    } else if (name !== POLICIES) {
      this.unknown ||= isCritical;
    }
  }

  mayIssue() {
    return this.issuer !== undefined && (this.key === undefined || (this.key & MAY_SIGN_CERTIFICATES) !== 0);
  }

  mayStamp() {
    return this.stamps && (this.key === undefined || (this.key & MAY_SIGN) !== 0);
  }
}

function readUses(der) {
  const [uses, seen] = [new Uses(), new Set()];
  const all = der.inside(SEQUENCE);
  der.end();
  while (!all.isEmpty()) {
    const one = all.inside(SEQUENCE);
    const name = hex(one.object());
    if (seen.has(name)) throw form(PART, "an extension appears twice");
    seen.add(name);
    const isCritical = one.nextTag() === BOOLEAN ? one.boolean() : false;
    const value = one.element(OCTETS).content;
    one.end();
    uses.take(name, isCritical, value);
  }
  return uses;
}

export class Certificate {
  static parse(der) {
    const found = new Certificate();
    const whole = outer(PART, der);
    const signed = whole.element(SEQUENCE);
    const named = whole.element(SEQUENCE).whole;
    Object.assign(found, { der, signed: signed.whole, ...schemeIn(named) });
    found.signature = whole.bits();
    whole.end();
    const inner = new Der(PART, signed.content);
    const version = inner.insideOptional(context(0));
    version?.small();
    version?.end();
    found.serial = inner.integer();
    if (!equal(inner.element(SEQUENCE).whole, named)) throw form(PART, "it names two signature algorithms");
    found.issuer = inner.element(SEQUENCE).whole;
    const [from, until] = inner.within(SEQUENCE, (validity) => [validity.any(), validity.any()]);
    found.subject = inner.element(SEQUENCE).whole;
    found.key = readKey(inner);
    for (const unique of [1, 2]) inner.optional(primitive(unique));
    const extensions = inner.insideOptional(context(3));
    found.uses = extensions ? readUses(extensions) : new Uses();
    inner.end();
    found.from = seconds(from, PART, false);
    found.until = seconds(until, PART, false);
    return found;
  }

  /** The first certificate of PEM. */
  static ofPem(pem) {
    const body = /-----BEGIN CERTIFICATE-----([^]*?)-----END CERTIFICATE-----/.exec(pem)?.[1];
    if (body === undefined) throw form(PART, "it is not a PEM certificate");
    const plain = body.replace(/[ \t\n\f\r]+/g, "");
    let binary;
    try {
      binary = atob(plain);
    } catch {
      throw form(PART, "its PEM is broken");
    }
    if (btoa(binary) !== plain) throw form(PART, "its PEM is broken");
    return Certificate.parse(Uint8Array.from(binary, (character) => character.charCodeAt(0)));
  }

  /** The common name of its subject, else its serial number. */
  name() {
    const found = commonName(this.subject);
    return found ?? "serial number " + hex(this.serial.subarray(0, 20));
  }

  expectValid(at) {
    if (this.from <= at && at <= this.until) return;
    throw new Broken(`the certificate of ${this.name()} was not valid then`);
  }
}

/** How it is signed. */
function schemeIn(named) {
  try {
    return { scheme: readScheme(new Der(PART, named)) };
  } catch (error) {
    if (!(error instanceof UnknownAlgorithm)) throw error;
    return { unknownScheme: error };
  }
}

function commonName(subject) {
  let found;
  try {
    const parts = Der.only(PART, subject, SEQUENCE);
    while (!parts.isEmpty()) {
      const set = parts.inside(SET);
      while (!set.isEmpty()) {
        const one = set.inside(SEQUENCE);
        if (hex(one.object()) === COMMON_NAME) found = clean(new TextDecoder().decode(one.any().content), 80);
      }
    }
  } catch (error) {
    if (!(error instanceof Broken)) throw error;
    return undefined;
  }
  return found;
}
