// A bundle in its parts (docs/format.md, section 11): each is within its bounds and of its form, or the bundle is refused.

import { sha256 } from "@noble/hashes/sha2.js";
import { address, keccak } from "./accounts.js";
import { unpacked } from "./archive.js";
import { ascii, concat, equal, hex, numberBytes, text } from "./bytes.js";
import { LONGEST_DER } from "./certificate.js";
import { BlockHeader } from "./header.js";
import * as json from "./json.js";
import { LONGEST_PATH, MOST_LEAVES } from "./merkle.js";
import { Broken, Malformed } from "./outcome.js";
import { LONGEST_RECORD, isBefore } from "./record.js";
import { keyOfPem, signatureOfDer } from "./sm2.js";
import { sm3 } from "./sm3.js";
import { parseNodes } from "./state.js";

const MEDIA_TYPE = "application/vnd.authros.evidence+zip";
const UNLISTED = ["mimetype", "manifest.json", "manifest.der"];
const MOST_RECORDS = 10_000;
const MOST_TOKENS = 4;
const LONGEST_REPORT = 2 ** 24;
const LONGEST_SMALL = 65_536;
const IDENTITY = 224;
/** A digest and a secret. */
const ENTRY = 64;
const STAMP_LABEL = ascii("AuthROS/stamp/1");
/** Bytes hashed between two reports of progress. */
const STEP = 2 ** 21;

const PATH = json.listOf(json.hash(32));
/** The names of the suite and its algorithms, which are compared. */
const SUITE = {
  name: "SM/1",
  signature: "SM2-SM3",
  digest: "SM3",
  cipher: "SM4-GCM",
  kdf: "HKDF-SM3",
  chain: "Keccak-256",
};
const MANIFEST = json.lines({
  format: json.string,
  suite: json.lines(Object.fromEntries(Object.keys(SUITE).map((name) => [name, json.string]))),
  chain: json.lines({ id: json.whole, genesis: json.hash(32), contract: json.account }),
  exporter: json.lines({ account: json.account, key: json.hash(32) }),
  members: json.listOf(json.lines({ name: json.string, bytes: json.whole, sm3: json.hash(32), sha256: json.hash(32) })),
});
const HEIGHTS = json.lines({
  format: json.string,
  heights: json.listOf(
    json.lines({ heads: json.hash(32), topic: json.hash(16), number: json.whole, index: json.whole, path: PATH }),
  ),
});
const STAMP = json.lines({
  format: json.string,
  top: json.hash(32),
  count: json.whole,
  roots: json.listOf(json.lines({ root: json.hash(32), index: json.whole, path: PATH })),
});
const BATCH = json.lines({
  mode: json.string,
  account: json.account,
  root: json.hash(32),
  index: json.whole,
  count: json.whole,
  path: PATH,
});
const EACH = json.lines({ mode: json.string });
const ANCHOR = json.lines({
  format: json.string,
  block: json.whole,
  shown_at: json.whole,
  keys: json.whole,
  anchor: (value) => {
    const mode = value instanceof Map ? value.get("mode") : undefined;
    if (mode !== "each" && mode !== "batch") throw new SyntaxError("neither each nor batch");
    return mode === "each" ? EACH(value) : BATCH(value);
  },
});

/** A member in JSON of this form and format. */
function read(name, bytes, form, format) {
  try {
    const told = json.parse(bytes);
    // Before the form, which a later version may have changed.
    const named = told instanceof Map ? told.get("format") : undefined;
    if (typeof named === "string" && named !== format)
      throw new Malformed(name, `has another format than ${format}; use a newer page`);
    return form(told);
  } catch (error) {
    if (!(error instanceof SyntaxError)) throw error;
    throw new Malformed(name, `is not of its form: ${error.message}`);
  }
}

function readAnchor(name, bytes) {
  const claim = read(name, bytes, ANCHOR, "authros-anchor/1");
  if (claim.anchor.path?.length > LONGEST_PATH) throw new Malformed(name, "a path is longer than in any batch");
  return claim;
}

function readHeights(name, bytes) {
  const { heights } = read(name, bytes, HEIGHTS, "authros-heights/1");
  if (heights.length > MOST_RECORDS) throw new Malformed(name, `has more than ${MOST_RECORDS} entries`);
  if (heights.some((height) => height.path.length > LONGEST_PATH))
    throw new Malformed(name, "a path is longer than in any batch");
  return heights;
}

function readStamp(name, bytes) {
  const listed = read(name, bytes, STAMP, "authros-stamp/1");
  const { roots, count } = listed;
  if (count > MOST_LEAVES || roots.length > MOST_LEAVES)
    throw new Malformed(name, `has more than ${MOST_LEAVES} entries`);
  if (roots.some((place, at) => at > 0 && !isBefore(roots[at - 1].root, place.root))) {
    throw new Malformed(name, "its roots are not in order, each once");
  }
  if (roots.some((place) => place.path.length > LONGEST_PATH))
    throw new Malformed(name, "a path is longer than in any batch");
  return listed;
}

function filedAs(name, holds, why) {
  if (!holds) throw new Malformed(name, why);
}

/** A signature in DER, or the member is not of its form. */
function readSignature(name, bytes) {
  try {
    return signatureOfDer(bytes);
  } catch (error) {
    if (error instanceof Broken) throw new Malformed(name, "the SM2 signature is malformed");
    throw error;
  }
}

const LARGE = ["chain/nodes.rlp", "manifest.json", "heights.json", "disclosed.bin"];

function longest(parts) {
  const [folder, , file] = parts;
  const isLarge = (folder === "records" && file === "record.bin") || (folder === "stamps" && file === "roots.json");
  if (isLarge || LARGE.includes(parts.join("/"))) return Infinity;
  return parts.length === 1 && folder === "report.html" ? LONGEST_REPORT : LONGEST_SMALL;
}

export class Bundle {
  records = new Map();
  stamps = new Map();
  keys = new Map();
  identities = new Map();
  headers = new Map();
  nodes = new Map();
  heights = [];

  /** `hashed` has SM3 of each member by name, so that nothing is hashed twice. */
  constructor(manifest, members, hashed) {
    this.manifest = manifest;
    this.members = members;
    this.hashed = hashed;
    for (const [name, bytes] of members) this.take(name, bytes);
    if (this.records.size > MOST_RECORDS || this.stamps.size > MOST_RECORDS) {
      throw new Malformed("the bundle", `has more than ${MOST_RECORDS} entries`);
    }
    for (const [digest, record] of this.records) finishRecord(digest, record);
    for (const [imprint, stamp] of this.stamps) finishStamp(imprint, stamp);
    this.disclosure = this.listedDisclosure();
    this.isSigned = this.exporterSigned();
  }

  take(name, bytes) {
    const parts = name.split("/");
    const [folder, filed, file] = parts;
    if (bytes.length > longest(parts)) throw new Malformed(name, "is longer than such a member can be");
    if (parts.length === 1) return this.takeTop(name, bytes);
    if (parts.length === 2) return this.takeFiled(name, folder, filed, bytes);
    if (parts.length !== 3 || (folder !== "records" && folder !== "stamps"))
      throw new Malformed(name, "does not belong in a bundle");
    filedAs(
      name,
      /^[0-9a-f]{64}$/.test(filed),
      folder === "records"
        ? "is filed under a name that is not a digest"
        : "is filed under a name that is not an imprint",
    );
    return folder === "records" ? this.takeRecord(name, filed, file, bytes) : this.takeStamp(name, filed, file, bytes);
  }

  takeTop(name, bytes) {
    if (name === "heights.json") this.heights = readHeights(name, bytes);
    else if (name === "disclosed.der") this.disclosedBy = readSignature(name, bytes);
    else if (name === "trust.toml") filedAs(name, text(bytes) !== undefined, "is not text");
    else
      filedAs(
        name,
        [...UNLISTED, "disclosed.bin", "VERIFY.txt", "report.html"].includes(name),
        "does not belong in a bundle",
      );
  }

  takeFiled(name, folder, filed, bytes) {
    if (folder === "keys") {
      const key = keyOfPem(text(bytes));
      filedAs(name, key, "contains no SM2 public key in a bundle's one form");
      filedAs(name, filed === `${hex(key.id)}.pem`, "is filed under another key's name");
      this.keys.set(hex(key.id), key);
    } else if (folder === "identities") {
      const hash = hex(keccak(bytes));
      filedAs(name, bytes.length === IDENTITY, "is not an identity");
      filedAs(name, filed === `${hash}.bin`, "is filed under another identity's name");
      this.identities.set(hash, bytes);
    } else if (folder === "definitions") {
      filedAs(name, filed === `${hex(this.hashed.get(name))}.txt`, "is filed under another text's name");
      filedAs(name, text(bytes) !== undefined, "is not text");
    } else if (name === "chain/nodes.rlp") {
      const nodes = parseNodes(bytes);
      filedAs(name, nodes, "is not a list of distinct nodes in order of their hashes");
      this.nodes = nodes;
    } else if (folder === "chain") {
      const header = BlockHeader.parse(bytes);
      filedAs(name, header, "is not a block header");
      filedAs(name, filed === `${header.number}.rlp`, "is filed under the number of another block");
      this.headers.set(header.number, header);
    } else {
      throw new Malformed(name, "does not belong in a bundle");
    }
  }

  takeRecord(name, digest, part, bytes) {
    if (!this.records.has(digest)) this.records.set(digest, { name });
    const record = this.records.get(digest);
    if (part === "record.bin") {
      if (bytes.length > LONGEST_RECORD) throw new Malformed(name, "is longer than any record can be");
      Object.assign(record, { bytes, sm3: this.hashed.get(name) });
    } else if (part === "signature.der") record.signature = readSignature(name, bytes);
    else if (part === "anchor.json") record.anchor = readAnchor(name, bytes);
    else throw new Malformed(name, "does not belong to a record");
  }

  takeStamp(name, imprint, part, bytes) {
    if (!this.stamps.has(imprint)) this.stamps.set(imprint, { tokens: [] });
    const stamp = this.stamps.get(imprint);
    if (part === "roots.json") {
      stamp.listed = readStamp(name, bytes);
      return;
    }
    const isNamed = bytes.length <= LONGEST_DER && part === `${hex(sha256(bytes)).slice(0, 32)}.der`;
    filedAs(name, isNamed, "is not a token named by its SHA-256");
    filedAs(name, stamp.tokens.length < MOST_TOKENS, "exceeds the limit of 4 tokens");
    stamp.tokens.push(bytes);
  }

  /** The secrets of disclosed records by digest, with the list's SM3 and signature; undefined if nothing is disclosed. */
  listedDisclosure() {
    const name = "disclosed.bin";
    const [list, signature] = [this.members.get(name), this.disclosedBy];
    if (!list && !signature) return undefined;
    if (!list || !signature) throw new Malformed(list ? "disclosed.der" : name, "is missing");
    const isList = list.length > 0 && list.length % ENTRY === 0 && list.length <= ENTRY * MOST_RECORDS;
    filedAs(name, isList, "is not a list of digests and secrets");
    const secrets = new Map();
    let before = "";
    for (let at = 0; at < list.length; at += ENTRY) {
      const digest = hex(list.subarray(at, at + ENTRY / 2));
      filedAs(name, before < digest, "is not in the order of its digests");
      filedAs(name, this.records.has(digest), "discloses a record that is not in the bundle");
      secrets.set(digest, list.subarray(at + ENTRY / 2, at + ENTRY));
      before = digest;
    }
    return { digest: this.hashed.get(name), signature, secrets };
  }

  /** Whether the exporter's key signed the manifest (DSSE's pre-authentication encoding). */
  exporterSigned() {
    const key = this.keys.get(hex(this.manifest.exporter.key));
    const [manifest, der] = [this.members.get("manifest.json"), this.members.get("manifest.der")];
    if (!key || !der) return false;
    const message = concat(ascii(`DSSEv1 ${MEDIA_TYPE.length} ${MEDIA_TYPE} ${manifest.length} `), manifest);
    try {
      return key.verify(message, signatureOfDer(der));
    } catch (error) {
      if (error instanceof Broken) return false;
      throw error;
    }
  }
}

function finishRecord(digest, record) {
  const missing = (part) => new Malformed(`records/${digest}/${part}`, "is missing");
  if (!record.bytes) throw missing("record.bin");
  if (!record.signature) throw missing("signature.der");
}

function finishStamp(imprint, { listed, tokens }) {
  const name = `stamps/${imprint}/roots.json`;
  if (!listed) throw new Malformed(name, "is missing");
  const found = hex(sha256(concat(STAMP_LABEL, listed.top, numberBytes(listed.count, 8))));
  filedAs(name, found === imprint, "is filed under another stamp's imprint");
  filedAs(name, tokens.length, "has no token with it");
}

/** Compares each member with the manifest; returns SM3 of each. `step` hears how many bytes were hashed. */
async function compared(manifest, members, step) {
  const hashed = new Map();
  const named = manifest.members;
  const there = [...members.keys()].filter((name) => !UNLISTED.includes(name));
  let [bytes, since] = [0, 0];
  for (let at = 0; at < Math.max(named.length, there.length); at++) {
    const [member, name] = [named[at], there[at]];
    if (member === undefined || (name !== undefined && name < member.name))
      throw new Malformed(name, "is present but not named in the manifest");
    if (name !== member.name) throw new Malformed(member.name, "is named in the manifest but missing");
    const content = members.get(name);
    const found = sm3(content);
    const isSame = member.bytes === BigInt(content.length) && equal(member.sm3, found);
    if (!isSame || !equal(member.sha256, sha256(content)))
      throw new Malformed(name, "does not match the manifest: its bytes were altered");
    hashed.set(name, found);
    bytes += content.length;
    since += content.length;
    if (since > STEP) {
      await step(bytes);
      since = 0;
    }
  }
  return hashed;
}

/** From a file's bytes; throws `Malformed`. `progress` hears of each stage: its name, and how much of it is done. */
export async function readBundle(file, progress) {
  const members = unpacked(file);
  if (!equal(members.get("mimetype") ?? new Uint8Array(0), ascii(MEDIA_TYPE)))
    throw new Malformed("mimetype", "does not say that this is an evidence bundle");
  const source = members.get("manifest.json");
  if (!source) throw new Malformed("manifest.json", "is missing");
  const manifest = read("manifest.json", source, MANIFEST, "authros-evidence/1");
  const isKnown = Object.entries(SUITE).every(([use, name]) => manifest.suite[use] === name);
  if (!isKnown) throw new Malformed("manifest.json", "names a suite or an algorithm that this page does not know");
  const records = new Set(
    manifest.members.filter(({ name }) => name.startsWith("records/")).map(({ name }) => name.slice(8, 72)),
  );
  await progress("members", 0, file.length, { records: records.size, exporter: address(manifest.exporter.account) });
  const hashed = await compared(manifest, members, (bytes) => progress("members", bytes, file.length));
  return new Bundle(manifest, members, hashed);
}
