// A record (docs/format.md, section 4): its public header, its sealed head, and what a disclosed secret opens.

import { ascii, big, concat, equal, numberBytes, Reader, startsWith } from "./bytes.js";
import { clean } from "./display.js";
import { Broken } from "./outcome.js";
import { expand, sm3 } from "./sm3.js";
import { gcmOpen } from "./sm4.js";
import { LONGEST_MESSAGE, unpackLz4, unpackMatrix } from "./unpack.js";

const MAGIC = concat(Uint8Array.of(0x89), ascii("AuthROS"));
const VERSION = 1;
/** SM4-GCM, SM3, SM2, HKDF-SM3. */
const SUITE_SM = 1;
const KINDS = 9;
const TAG = 16;
const MOST_FILTERS = 4;
const MOST_TAGS = 64;
const LARGEST_HEAD = 65_536;
const LARGEST_BODY = LONGEST_MESSAGE + TAG;
const LARGEST_STORED = (1n << 63n) - 1n;
const LARGEST_SEQ = 1n << 40n;
const RECORDERS = [1, 2];
const RING = 2;
export const LONGEST_RECORD = LARGEST_HEAD + LARGEST_BODY + 1024;

export const domainOf = (chain) =>
  sm3(ascii("AuthROS/domain/1"), numberBytes(chain.id, 8), chain.genesis, chain.contract);

function expect(holds, field) {
  if (!holds) throw new Broken(`the ${field} has an invalid value`);
}

/** The fields of a record's header, and its length. */
export function parseHeader(record) {
  const reader = new Reader(record);
  expect(equal(reader.take(8, "magic"), MAGIC), "magic");
  expect(reader.small(1, "version") === VERSION, "version");
  expect(reader.small(1, "suite") === SUITE_SM, "suite");
  const header = { kind: reader.small(1, "kind") };
  expect(header.kind >= 1 && header.kind <= KINDS, "kind");
  const sizes = { domain: 32, owner: 20, signer: 32, epoch: 8, recorder: 16, seq: 8, topicId: 16 };
  for (const [name, length] of Object.entries(sizes)) header[name] = reader.take(length, name);
  const filters = reader.small(1, "filter count");
  expect(filters <= MOST_FILTERS, "filter count");
  reader.take(8 * filters, "filter");
  header.capturedAt = reader.number(8, "capture time");
  header.headLength = reader.small(4, "head length");
  header.bodyLength = reader.number(8, "body length");
  header.salt = reader.take(24, "salt");
  header.commit = reader.take(32, "commit");
  [header.epoch, header.seq] = [big(header.epoch), big(header.seq)];
  expect(header.headLength >= TAG && header.headLength <= LARGEST_HEAD, "head length");
  expect(header.bodyLength >= TAG && header.bodyLength <= LARGEST_BODY, "body length");
  expect(header.epoch >= 1n && header.epoch <= LARGEST_STORED, "epoch");
  expect(header.seq >= 1n && header.seq <= LARGEST_SEQ, "seq, which is 1 to 2^40,");
  expect(header.capturedAt <= LARGEST_STORED, "capture time");
  const isOfSigner = equal(header.recorder.subarray(8), header.signer.subarray(0, 8));
  expect(RECORDERS.includes(header.recorder[0]) && isOfSigner, "recorder, which is not of the key that signs,");
  return { header, length: reader.at };
}

export const isRing = (recorder) => recorder[0] === RING;

function parseHead(bytes) {
  const reader = new Reader(bytes);
  const head = { topic: reader.word("topic"), type: reader.word("type"), md5sum: reader.word("md5sum") };
  head.definition = reader.take(32, "definition");
  head.publisher = reader.word("caller id");
  reader.take(16, "boot id");
  head.compression = reader.small(1, "compression");
  expect(head.compression <= 2, "compression");
  head.plainLength = reader.number(8, "plain length");
  const count = reader.small(2, "tag count");
  expect(count <= MOST_TAGS, "tag count");
  head.tags = [];
  let before;
  for (let at = 0; at < count; at++) {
    const name = reader.word("tag");
    const bytes = ascii(name);
    expect(before === undefined || isBefore(before, bytes), "tag");
    head.tags.push([name, reader.word("tag")]);
    before = bytes;
  }
  expect(reader.at === bytes.length, "head's end");
  return head;
}

export function isBefore(one, other) {
  for (let at = 0; at < Math.min(one.length, other.length); at++) {
    if (one[at] !== other[at]) return one[at] < other[at];
  }
  return one.length < other.length;
}

/** Keys of one record, from the secret that its owner disclosed. */
function keysOf(secret, header) {
  const { domain, owner, recorder, epoch, seq } = header;
  const place = [domain, owner, recorder, numberBytes(epoch, 8), numberBytes(seq, 8)];
  const reader = new Reader(expand(secret, concat(ascii("AuthROS/record/1"), ...place), 88));
  const [bodyKey, bodyNonce, headKey, headNonce, commit] = [16, 12, 16, 12, 32].map((length) => reader.take(length));
  return { bodyKey, bodyNonce, headKey, headNonce, commit };
}

/** Head and message of a disclosed record; undefined if they are longer than `left.bytes`, from which they are taken. */
export async function opened(record, secret, left) {
  const { header, length } = parseHeader(record);
  const keys = keysOf(secret, header);
  if (!equal(keys.commit, header.commit)) throw new Broken("the secret does not belong to the record");
  const [aad, sealed] = [record.subarray(0, length), record.subarray(length)];
  const plainHead = gcmOpen(keys.headKey, keys.headNonce, aad, sealed.subarray(0, header.headLength));
  if (!plainHead) throw new Broken("the tag of the head does not hold");
  const body = gcmOpen(keys.bodyKey, keys.bodyNonce, aad, sealed.subarray(header.headLength));
  if (!body) throw new Broken("the tag of the body does not hold");
  const head = parseHead(plainHead);
  const plain = head.plainLength;
  const isPacked = head.compression !== 0;
  const fits = isPacked ? BigInt(body.length) < plain && plain <= LONGEST_MESSAGE : BigInt(body.length) === plain;
  if (!fits) throw new Broken("the message has another length");
  if (plain > BigInt(left.bytes)) return undefined;
  left.bytes -= Number(plain);
  return { head, body: await unpacked(head.compression, body, Number(plain)) };
}

function unpacked(compression, body, length) {
  if (compression === 1) return unpackLz4(body, length);
  return compression === 2 ? unpackMatrix(body, length) : body;
}

/** What is shown of a disclosed message. */
export function disclosed({ head, body }) {
  return {
    topic: clean(head.topic, 256),
    type: clean(head.type, 256),
    publisher: clean(head.publisher, 256),
    length: body.length,
    messageSm3: sm3(body),
    tags: head.tags.map(([name, value]) => [clean(name, 64), clean(value, 256)]),
  };
}

// A recorder's statements about itself.

export const RECORDER_TOPIC = "authros/recorder";
export const BIRTH = "authros/Birth";
export const HEADS = "authros/Heads";
const HEADS_LABEL = ascii("AuthROS/heads/1");

/** The count and the root of a head over highest numbers; undefined if it is not one. */
export function parseHeads(body) {
  if (body.length !== HEADS_LABEL.length + 100 || !startsWith(body, HEADS_LABEL)) return undefined;
  const reader = new Reader(body.subarray(HEADS_LABEL.length));
  return { count: reader.number(4), root: reader.take(32) };
}
