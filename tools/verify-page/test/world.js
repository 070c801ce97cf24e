// A chain with records, and everything that can be a lie: bundles made from docs/format.md, section 11.

import { createHash, randomBytes } from "node:crypto";
import { secp256k1 } from "@noble/curves/secp256k1.js";
import { keccak_256 } from "@noble/hashes/sha3.js";
import { Key, expand, gcmSeal, sm3, u64 } from "./sealing.js";

export const BLOCK = 40;
export const TIME = 1_700_000_100;
const GENESIS = Buffer.alloc(32, 9);
const CONTRACT = Buffer.alloc(20, 0xc0);
const CODE = Buffer.alloc(32, 0xcc);
const MEDIA = "application/vnd.authros.evidence+zip";
const MIX = Buffer.from("ctical byzantine fault tolerance");

export const keccak = (...parts) => Buffer.from(keccak_256(Buffer.concat(parts)));
const sha256 = (...parts) => createHash("sha256").update(Buffer.concat(parts)).digest();
const concat = (...parts) => Buffer.concat(parts.map((part) => Buffer.from(part)));
const u32 = (number) => Buffer.from(number.toString(16).padStart(8, "0"), "hex");
const hex = (bytes) => Buffer.from(bytes).toString("hex");
const json = (value) => Buffer.from(JSON.stringify(value, null, 2));
export const DOMAIN = sm3(concat("AuthROS/domain/1", u64(7), GENESIS, CONTRACT));

// RLP (Yellow Paper, appendix B): bytes or lists of them.
export function rlp(item) {
  const body = Array.isArray(item) ? Buffer.concat(item.map(rlp)) : Buffer.from(item);
  const base = Array.isArray(item) ? 0xc0 : 0x80;
  if (base === 0x80 && body.length === 1 && body[0] < 0x80) return body;
  if (body.length < 56) return concat([base + body.length], body);
  const size = short(body.length);
  return concat([base + 55 + size.length], size, body);
}
export const short = (number) => {
  const digits = BigInt(number).toString(16);
  return number ? Buffer.from(digits.padStart(digits.length + (digits.length % 2), "0"), "hex") : Buffer.alloc(0);
};

// Tries (appendix D).
const nibbles = (bytes) => Array.from(bytes).flatMap((byte) => [byte >> 4, byte & 15]);
function packedPath(path, leaf) {
  const flag = 2 * leaf + (path.length % 2);
  const all = path.length % 2 ? [flag, ...path] : [flag, 0, ...path];
  return Buffer.from(Array.from({ length: all.length / 2 }, (_, at) => all[2 * at] * 16 + all[2 * at + 1]));
}
function built(pairs, depth, nodes) {
  if (pairs.length === 1) return [packedPath(pairs[0].path.slice(depth), 1), pairs[0].value];
  let common = 0;
  while (pairs.every(({ path }) => path[depth + common] === pairs[0].path[depth + common])) common++;
  const child = (some, at) => {
    const node = built(some, at, nodes);
    const bytes = rlp(node);
    if (bytes.length < 32) return node;
    nodes.push(bytes);
    return keccak(bytes);
  };
  if (common) return [packedPath(pairs[0].path.slice(depth, depth + common), 0), child(pairs, depth + common)];
  const list = Array.from({ length: 16 }, (_, nibble) => {
    const some = pairs.filter(({ path }) => path[depth] === nibble);
    return some.length ? child(some, depth + 1) : Buffer.alloc(0);
  });
  return [...list, Buffer.alloc(0)];
}
export function trie(pairs, nodes) {
  const all = pairs.map(([key, value]) => ({ path: nibbles(keccak(key)), value }));
  const root = rlp(built(all, 0, nodes));
  nodes.push(root);
  return keccak(root);
}

// Accounts and headers.
export const account = (secret) => {
  const point = secp256k1.getPublicKey(Buffer.alloc(32, secret), false);
  return keccak(point.subarray(1)).subarray(12);
};
export function sealBy(secret, hash) {
  const made = secp256k1.sign(hash, Buffer.alloc(32, secret), { prehash: false, format: "recovered" });
  return concat(made.subarray(1), [made[0]]);
}
const VANITY = Buffer.alloc(32);
const fieldsOf = (number, parent, state, extra, mix) => [
  parent,
  Buffer.alloc(32, 1),
  Buffer.alloc(20),
  state,
  Buffer.alloc(32, 2),
  Buffer.alloc(32, 3),
  Buffer.alloc(256),
  short(2),
  short(number),
  short(1000),
  short(0),
  short(TIME + number - BLOCK),
  extra,
  mix,
  Buffer.alloc(8),
];
/** Clique, sealed by nobody if `sealer` is 0. */
export function cliqueHeader(number, parent, state, sealer, vanity = VANITY) {
  const header = (extra) => rlp(fieldsOf(number, parent, state, extra, Buffer.alloc(32)));
  return sealer ? header(concat(vanity, sealBy(sealer, keccak(header(vanity))))) : header(vanity);
}
/** QBFT, or IBFT 2.0. */
export function committedHeader(number, parent, state, { named, sealers, round = 0, said = round, isIbft = false }) {
  const vote = isIbft ? Buffer.alloc(0) : [];
  const extra = (at, seals) => {
    const digits = isIbft ? u32(at) : short(at);
    const list = [Buffer.alloc(32, 7), named.map(account), vote, digits];
    return rlp(seals ? [...list, seals] : isIbft ? list : [...list, []]);
  };
  const header = (bytes) => rlp(fieldsOf(number, parent, state, bytes, MIX));
  const signed = keccak(header(extra(round)));
  return header(
    extra(
      said,
      sealers.map((sealer) => sealBy(sealer, signed)),
    ),
  );
}

// Records.
const text = (word) => concat([word.length >> 8, word.length & 255], word);
export function sealRecord(owner, signer, seq, message, options = {}) {
  const {
    topic = "/robot1/odom",
    type = "std_msgs/String",
    compression = 0,
    plainLength = message.length,
    kind = 1,
  } = options;
  const topicKey = Buffer.alloc(32, 6);
  const topicId = options.topicId ?? Buffer.alloc(16, 8);
  const recorder = concat([options.recorder ?? 1], Buffer.alloc(7, 4), signer.id.subarray(0, 8));
  const salt = randomBytes(24);
  const tags = Object.entries(options.tags ?? {}).map(([name, value]) => concat(text(name), text(value)));
  const head = concat(
    text(topic),
    text(type),
    text("0".repeat(32)),
    Buffer.alloc(32, 4),
    text("/robot1"),
    Buffer.alloc(16, 5),
    [compression],
    u64(plainLength),
    [0, tags.length],
    ...tags,
  );
  const captured = BigInt(options.captured ?? TIME - 7) * 1_000_000_000n;
  const before = concat(
    [0x89],
    "AuthROS",
    [1, 1, kind],
    DOMAIN,
    owner,
    signer.id,
    u64(1),
    recorder,
    u64(seq),
    topicId,
    [0],
    u64(captured),
    u32(head.length + 16),
    u64(message.length + 16),
    salt,
  );
  const secret = hmac(salt, topicKey);
  const info = concat("AuthROS/record/1", DOMAIN, owner, recorder, u64(1), u64(seq));
  const keys = expand(secret, info, 88);
  const aad = concat(before, keys.subarray(56));
  const sealed = [
    [keys.subarray(28, 44), keys.subarray(44, 56), head],
    [keys.subarray(0, 16), keys.subarray(16, 28), message],
  ];
  const bytes = concat(aad, ...sealed.map(([key, nonce, plain]) => gcmSeal(key, nonce, aad, Buffer.from(plain))));
  const digest = sm3(bytes);
  const signature = signer.signDer(concat("AuthROS/signature/1", DOMAIN, digest));
  const leaf = sm3(Buffer.of(0), owner, signer.id, recorder, topicId, u64(seq), digest);
  return { bytes, digest, signature, secret, leaf };
}
const hmac = (salt, key) => {
  const padded = Buffer.concat([salt, Buffer.alloc(64 - salt.length)]);
  return sm3(
    padded.map((byte) => byte ^ 0x5c),
    sm3(
      padded.map((byte) => byte ^ 0x36),
      key,
    ),
  );
};

// RFC 6962's tree.
export function tree(leaves) {
  if (leaves.length === 1) return { root: leaves[0], paths: [[]] };
  let split = 1;
  while (split * 2 < leaves.length) split *= 2;
  const [left, right] = [tree(leaves.slice(0, split)), tree(leaves.slice(split))];
  const paths = [
    ...left.paths.map((path) => [...path, right.root]),
    ...right.paths.map((path) => [...path, left.root]),
  ];
  return { root: sm3(Buffer.of(1), left.root, right.root), paths };
}

// The contract's storage.
const padded = (bytes) => Buffer.concat([Buffer.alloc(32 - bytes.length), bytes]);
const mapped = (key, below) => keccak(padded(key), padded(below));
export const slot = {
  anchor: (who, root) => mapped(root, mapped(who, Buffer.of(8))),
  loan: (owner, device) => mapped(device, mapped(owner, Buffer.of(9))),
  account: (who) => mapped(who, Buffer.of(10)),
  keys: (who, version) => mapped(u64(version), mapped(who, Buffer.of(15))),
  next: (one) => padded(short(BigInt("0x" + hex(one)) + 1n)),
};
/** Numbers of eight bytes, from the low end. */
export const word = (...numbers) => padded(concat(...numbers.map(u64).reverse()));

export class World {
  owner = Buffer.alloc(20, 0x0e);
  keys = new Key();
  slots = new Map();
  sealers = [1, 2];
  shownAt = BLOCK;
  vanity = VANITY;
  more = {};

  constructor({ signer, count = 1, message = (at) => Buffer.from(`message ${at}`), options = () => ({}) } = {}) {
    this.signer = signer ?? this.keys;
    const numbers = Array.from({ length: count }, (_, at) => at);
    this.records = numbers.map((at) => sealRecord(this.owner, this.signer, at + 3, message(at), options(at)));
    const others = Array.from({ length: 4 }, (_, at) => Buffer.alloc(32, at));
    this.tree = tree([...others, ...this.records.map((record) => record.leaf)]);
    this.root = this.tree.root;
    this.count = count + 4;
    this.claims = numbers.map((at) => this.claim(at + 4));
    const envelope = new Key().public;
    const signed = concat("AuthROS/identity/1", DOMAIN, this.owner, this.keys.public, envelope, Buffer.alloc(32, 5));
    this.identity = concat(Buffer.alloc(32, 5), this.keys.public, envelope, this.keys.sign(signed));
    this.put(slot.anchor(this.owner, this.root), word(BLOCK, this.count, TIME, 1));
    this.put(slot.account(this.owner), word(1, 0, 1));
    this.put(slot.keys(this.owner, 1), keccak(this.identity));
    this.put(slot.next(slot.keys(this.owner, 1)), word(10, TIME - 50));
  }

  put(place, value) {
    this.slots.set(hex(place), value);
  }

  claim(index) {
    const path = this.tree.paths[index].map(hex);
    const anchor = {
      mode: "batch",
      account: "0x" + hex(this.owner),
      root: hex(this.root),
      index,
      count: this.count,
      path,
    };
    return { format: "authros-anchor/1", block: BLOCK, shown_at: BLOCK, keys: 1, anchor };
  }

  /** Discloses records by their places. */
  disclose(places, by = this.keys) {
    const some = places.map((at) => this.records[at]).sort((one, other) => Buffer.compare(one.digest, other.digest));
    const list = concat(...some.flatMap(({ digest, secret }) => [digest, secret]));
    this.more["disclosed.bin"] = list;
    this.more["disclosed.der"] = by.signDer(concat("AuthROS/reveal/2", DOMAIN, list));
  }

  members() {
    const nodes = [];
    const filled = [...this.slots].filter(([, value]) => value.some((byte) => byte));
    const storage = trie(
      filled.map(([place, value]) => [Buffer.from(place, "hex"), rlp(value.subarray(value.findIndex((byte) => byte)))]),
      nodes,
    );
    const state = trie(
      [
        [CONTRACT, rlp([short(1), short(0), storage, CODE])],
        [Buffer.alloc(20, 7), rlp(Buffer.alloc(40, 1))],
      ],
      nodes,
    );
    const members = { ...this.more };
    let parent = Buffer.alloc(32, 8);
    for (const [at, sealer] of this.sealers.entries()) {
      const number = this.shownAt + at;
      const header = this.commit
        ? committedHeader(number, parent, state, this.commit)
        : cliqueHeader(number, parent, state, sealer, this.vanity);
      members[`chain/${number}.rlp`] = header;
      parent = keccak(header);
    }
    const hashed = new Map(nodes.map((node) => [hex(keccak(node)), node]));
    members["chain/nodes.rlp"] = rlp([...hashed.keys()].sort().map((hash) => hashed.get(hash)));
    for (const key of new Set([this.keys, this.signer])) members[`keys/${hex(key.id)}.pem`] = key.pem();
    members[`identities/${hex(keccak(this.identity))}.bin`] = this.identity;
    this.records.forEach((record, at) => {
      const folder = `records/${hex(record.digest)}`;
      members[`${folder}/record.bin`] = record.bytes;
      members[`${folder}/signature.der`] = record.signature;
      members[`${folder}/anchor.json`] = json({ ...this.claims[at], shown_at: this.shownAt });
    });
    return members;
  }

  /** The file, its members changed by `change` before they are signed for. */
  file(change = (members) => members) {
    return pack(signed(change(this.members()), this));
  }
}

export function signed(members, { owner, keys }) {
  const names = Object.keys(members).sort();
  const listed = names.map((name) => {
    const bytes = members[name];
    return { name, bytes: bytes.length, sm3: hex(sm3(bytes)), sha256: hex(sha256(bytes)) };
  });
  const suite = {
    name: "SM/1",
    signature: "SM2-SM3",
    digest: "SM3",
    cipher: "SM4-GCM",
    kdf: "HKDF-SM3",
    chain: "Keccak-256",
  };
  const chain = { id: 7, genesis: hex(GENESIS), contract: "0x" + hex(CONTRACT) };
  const exporter = { account: "0x" + hex(owner), key: hex(keys.id) };
  const manifest = json({ format: "authros-evidence/1", suite, chain, exporter, members: listed });
  return withManifest(members, manifest, keys);
}

export function withManifest(members, manifest, keys) {
  const message = concat(`DSSEv1 36 ${MEDIA} ${manifest.length} `, manifest);
  return { ...members, "manifest.json": manifest, "manifest.der": keys.signDer(message), mimetype: Buffer.from(MEDIA) };
}

const u16s = (...words) => concat(...words.map((one) => [one & 255, one >> 8]));
const u32s = (...words) =>
  concat(...words.map((one) => [one & 255, (one >>> 8) & 255, (one >>> 16) & 255, one >>> 24]));

function crc32(bytes) {
  let sum = -1;
  for (const byte of bytes) {
    sum ^= byte;
    for (let bit = 0; bit < 8; bit++) sum = (sum >>> 1) ^ (sum & 1 ? 0xedb88320 : 0);
  }
  return ~sum >>> 0;
}

/** ZIP, stored, `mimetype` first. */
export function pack(members) {
  const names = [
    "mimetype",
    ...Object.keys(members)
      .filter((name) => name !== "mimetype")
      .sort(),
  ];
  const [parts, central] = [[], []];
  let at = 0;
  for (const name of names) {
    const bytes = members[name];
    const same = concat(u16s(10, 0, 0, 0, 0x21), u32s(crc32(bytes), bytes.length, bytes.length), u16s(name.length, 0));
    central.push(concat("PK\u0001\u0002", u16s(10), same, Buffer.alloc(10), u32s(at), name));
    parts.push(concat("PK\u0003\u0004", same, name), bytes);
    at += 30 + name.length + bytes.length;
  }
  const listed = Buffer.concat(central);
  const end = concat("PK\u0005\u0006", u16s(0, 0, names.length, names.length), u32s(listed.length, at), u16s(0));
  return Buffer.concat([...parts, listed, end]);
}

export function trust(changes = {}, more = "") {
  const lines = {
    id: 7,
    genesis: `"${hex(GENESIS)}"`,
    contract: `"0x${hex(CONTRACT)}"`,
    code_hash: `"${hex(CODE)}"`,
    signers: `[${[1, 2, 3].map((secret) => `"0x${hex(account(secret))}"`).join(", ")}]`,
    sealed_by_exporter: false,
    ...changes,
  };
  const written = Object.entries(lines).filter(([, value]) => value !== undefined);
  return Buffer.from(`[chain]\n${written.map(([name, value]) => `${name} = ${value}\n`).join("")}${more}`);
}
