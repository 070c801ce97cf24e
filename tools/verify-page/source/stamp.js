// Time stamps of authorities (RFC 3161, CMS SignedData of RFC 5652), and the path from their certificates to a pinned one
// (RFC 5280, 6, with names compared byte by byte). Revocation is not looked up.

import { sha1 } from "@noble/hashes/legacy.js";
import { concat, equal, hex } from "./bytes.js";
import { Certificate, OID, SHA_256, hashOf, outer, readScheme, seconds, verifyBy, withHash } from "./certificate.js";
import {
  BOOLEAN,
  Der,
  GENERALIZED_TIME,
  INTEGER,
  OBJECT,
  OCTETS,
  SEQUENCE,
  SET,
  context,
  primitive,
  smallNumber,
} from "./der.js";
import { Broken } from "./outcome.js";

const PART = "token";
const INFO = "stamp";
const SIGNER = "signer's part";
const MOST_CERTIFICATES = 8;
const MOST_ATTRIBUTES = 16;
/** The most certificates between the first and the pinned one. */
const LONGEST = 6;

const form = (part, why) => new Broken(`the ${part} is malformed: ${why}`);

/** Accuracy in whole seconds, rounded up. */
function spread(accuracy) {
  const whole = accuracy.nextTag() === INTEGER ? accuracy.small() : 0;
  let part = 0;
  for (const number of [0, 1]) {
    const fraction = accuracy.optional(primitive(number));
    if (!fraction) continue;
    const found = fraction.content.length ? smallNumber(fraction.content) : 0;
    if (!(found >= 1 && found <= 999)) throw accuracy.wrong("its accuracy is invalid");
    part = 1;
  }
  accuracy.end();
  return whole + part;
}

function parseInfo(bytes) {
  const info = Der.only(INFO, bytes, SEQUENCE);
  if (info.small() !== 1) throw form(INFO, "its version is not supported");
  info.element(OBJECT);
  const over = info.inside(SEQUENCE);
  let hash;
  try {
    hash = hashOf(over);
  } catch {
    hash = undefined;
  }
  if (hash !== SHA_256) throw new Broken("its message imprint is not SHA-256");
  const imprint = over.element(OCTETS).content;
  over.end();
  info.integer();
  const time = info.element(GENERALIZED_TIME);
  const accuracy = info.insideOptional(SEQUENCE);
  const late = accuracy ? spread(accuracy) : 0;
  if (info.nextTag() === BOOLEAN) info.boolean();
  if (info.nextTag() === INTEGER) info.integer();
  info.optional(context(0));
  if (info.nextTag() === context(1)) throw form(INFO, "it has extensions, which are not supported");
  info.end();
  return { imprint, at: seconds(time, INFO, false), before: seconds(time, INFO, true) + late };
}

function parseAttributes(bytes) {
  const [all, found] = [new Der(SIGNER, bytes), new Map()];
  while (!all.isEmpty()) {
    const one = all.inside(SEQUENCE);
    const name = hex(one.object());
    const value = one.within(SET, (values) => values.any()).whole;
    one.end();
    if (found.size >= MOST_ATTRIBUTES || found.has(name))
      throw form(SIGNER, "an attribute is a duplicate, or one too many");
    found.set(name, value);
  }
  return found;
}

function parseSigner(signers) {
  const one = signers.inside(SEQUENCE);
  if (one.small() !== 1) throw form(SIGNER, "it does not name its certificate by issuer and serial number");
  const [issuer, serial] = one.within(SEQUENCE, (name) => [name.element(SEQUENCE).whole, name.integer()]);
  const hash = hashOf(one);
  const listed = one.element(context(0));
  // What the signature covers: the attributes as a SET.
  const signed = concat(Uint8Array.of(SET), listed.whole.subarray(1));
  const scheme = withHash(readScheme(one), hash);
  if (!scheme) throw form(SIGNER, "it names two hashes");
  const signature = one.element(OCTETS).content;
  if (!one.isEmpty()) throw form(SIGNER, "it has attributes that nobody signed");
  return { issuer, serial, hash, scheme, signature, signed, attributes: parseAttributes(listed.content) };
}

function parseCertificates(data) {
  const all = data.insideOptional(context(0));
  const found = [];
  while (all && !all.isEmpty()) {
    if (found.length >= MOST_CERTIFICATES) throw form(PART, "it includes more than 8 certificates");
    found.push(Certificate.parse(all.element(SEQUENCE).whole));
  }
  return found;
}

function parseToken(bytes) {
  const whole = outer(PART, bytes);
  if (hex(whole.object()) !== OID.signedData) throw form(PART, "it is not signed data");
  const data = whole.within(context(0), (wrapped) => wrapped.inside(SEQUENCE));
  whole.end();
  // RFC 5652, 5.1: content other than plain data.
  if (data.small() !== 3) throw form(PART, "its version is not supported");
  const hash = data.within(SET, hashOf);
  const about = data.inside(SEQUENCE);
  if (hex(about.object()) !== OID.stamp) throw form(PART, "it is signed data, but not a time stamp");
  const { content } = about.within(context(0), (explicit) => explicit.element(OCTETS));
  about.end();
  const certificates = parseCertificates(data);
  if (data.nextTag() === context(1))
    throw form(PART, "it includes certificate revocation lists, which are not supported");
  const signer = data.within(SET, parseSigner);
  data.end();
  if (signer.hash !== hash) throw form(PART, "it names a different hash than its signer does");
  return { info: parseInfo(content), content, certificates, signer };
}

function expectContent(signer, content) {
  const attribute = (name) => {
    const found = signer.attributes.get(name);
    if (!found) throw form(SIGNER, "a required attribute is missing");
    return new Der(SIGNER, found);
  };
  const kind = attribute(OID.contentType);
  const isStamp = hex(kind.object()) === OID.stamp;
  kind.end();
  const hash = attribute(OID.messageDigest);
  const isThis = equal(hash.element(OCTETS).content, signer.hash.of(content));
  hash.end();
  if (!isStamp || !isThis) throw new Broken("its signature covers different content");
}

/**
 * The signer names its certificate, so that no other with the same key can replace it. SHA-1 (RFC 2634) is accepted: many
 * authorities still write it, and to substitute a certificate takes a second preimage.
 */
function expectNamed(signer, certificate) {
  let isNamed = false;
  for (const name of [OID.signingCertificate2, OID.signingCertificate]) {
    const found = signer.attributes.get(name);
    if (!found) continue;
    const value = new Der(SIGNER, found);
    const outside = value.inside(SEQUENCE);
    value.end();
    // The first is the signer's own; policies may follow.
    const own = outside.inside(SEQUENCE).inside(SEQUENCE);
    const second = () => (own.nextTag() === SEQUENCE ? hashOf(own) : SHA_256).of(certificate.der);
    const hash = name === OID.signingCertificate2 ? second() : sha1(certificate.der);
    if (!equal(own.element(OCTETS).content, hash))
      throw new Broken("its signature does not name its certificate (ESSCertID)");
    isNamed = true;
  }
  if (!isNamed) throw new Broken("its signature does not name its certificate (ESSCertID)");
}

/** Broken unless `above` issued `below`, with the given number of certificates between that one and the first. */
async function expectIssued(above, below, between) {
  if (!above.uses.mayIssue() || above.uses.issuer < between)
    throw new Broken(`the certificate of ${above.name()}, in the chain, may not issue others`);
  if (below.unknownScheme) throw below.unknownScheme;
  await verifyBy(above.key, below.scheme, below.signed, below.signature);
}

async function issuerOf(last, known, below) {
  let fault;
  for (const above of known.filter((one) => equal(one.subject, last.issuer) && !equal(one.der, last.der))) {
    try {
      await expectIssued(above, last, below);
      return above;
    } catch (error) {
      if (!(error instanceof Broken)) throw error;
      fault ??= error;
    }
  }
  if (fault) throw fault;
  return undefined;
}

/** Whether the certificates lead to the pinned one, each valid at this time. */
async function isWay(first, others, pinned, at) {
  let last = first;
  for (let below = 0; below < LONGEST; below++) {
    last.expectValid(at);
    if (last.uses.unknown) throw new Broken(`the certificate of ${last.name()} has an unknown critical extension`);
    if (equal(last.der, pinned.der)) return true;
    last = await issuerOf(last, [pinned, ...others], below);
    if (!last) return false;
  }
  return false;
}

/** Which of the pinned certificates it leads to; undefined if to none. */
async function wayOf(first, others, pinned, at) {
  let fault;
  for (const [place, one] of pinned.entries()) {
    try {
      if (await isWay(first, others, one, at)) return place;
    } catch (error) {
      if (!(error instanceof Broken)) throw error;
      fault ??= error;
    }
  }
  if (fault) throw fault;
  return undefined;
}

/** What a token over this imprint states; broken if it contradicts itself. `pinned` are certificates. */
export async function checkToken(bytes, imprint, pinned) {
  const { info, content, certificates, signer } = parseToken(bytes);
  if (!equal(info.imprint, imprint)) throw new Broken("it stamps something else");
  const isSigners = (one) => equal(one.issuer, signer.issuer) && equal(one.serial, signer.serial);
  const certificate = [...certificates, ...pinned].find(isSigners);
  if (!certificate) throw new Broken("it does not include its signer's certificate");
  expectContent(signer, content);
  expectNamed(signer, certificate);
  await verifyBy(certificate.key, signer.scheme, signer.signed, signer.signature);
  if (!certificate.uses.mayStamp()) throw new Broken("its certificate is not restricted to time stamping");
  certificate.expectValid(info.at);
  const leads = await wayOf(certificate, certificates, pinned, info.at);
  return { before: info.before, signer: certificate.name(), pinned: leads };
}
