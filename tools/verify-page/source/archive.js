// The archive: ZIP in one form only, so that nothing hides between members. It is read once, and every byte is accounted for.

import { equal, text } from "./bytes.js";
import { Malformed } from "./outcome.js";

export const LARGEST = 256 * 2 ** 20;
const MOST_MEMBERS = 60_000;
const LONGEST_NAME = 120;
const FIRST = "mimetype";
const [LOCAL, CENTRAL, END] = [0x04034b50, 0x02014b50, 0x06054b50];
const CRC = Uint32Array.from({ length: 256 }, (_, byte) => {
  let sum = byte;
  for (let bit = 0; bit < 8; bit++) sum = sum & 1 ? (sum >>> 1) ^ 0xedb88320 : sum >>> 1;
  return sum;
});
export const WHOLE = "the bundle";
export const TOO_LONG = "it is longer than 256 MiB, and no bundle is";

function crc32(bytes) {
  let sum = 0xffffffff;
  for (let at = 0; at < bytes.length; at++) sum = CRC[(sum ^ bytes[at]) & 255] ^ (sum >>> 8);
  return (sum ^ 0xffffffff) >>> 0;
}

/** Whether a name may be a member's: plain ASCII, and no way out of the folder that it is unpacked into. */
export function isName(name) {
  return name.length <= LONGEST_NAME && /^[A-Za-z0-9_-][A-Za-z0-9._-]*(\/[A-Za-z0-9_-][A-Za-z0-9._-]*)*$/.test(name);
}

/** Version, no flags, stored, 1 January 1980, checksum, lengths: what local and central headers have in common. */
function fields(name, content) {
  const view = new DataView(new ArrayBuffer(26));
  [10, 0, 0, 0, 0x21].forEach((word, at) => view.setUint16(2 * at, word, true));
  view.setUint32(10, crc32(content), true);
  view.setUint32(14, content.length, true);
  view.setUint32(18, content.length, true);
  view.setUint16(22, name.length, true);
  return new Uint8Array(view.buffer);
}

/** Members by name, in their order in the file. `step` hears how many bytes were read. */
export function unpacked(bytes, step = () => {}) {
  if (bytes.length > LARGEST) throw new Malformed(WHOLE, TOO_LONG);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  const members = new Map();
  const headers = [];
  let at = 0;
  while (at + 4 <= bytes.length && view.getUint32(at, true) === LOCAL) {
    const begin = at + 30;
    if (begin > bytes.length) throw new Malformed(WHOLE, "it ends in the middle of a member; ask for the file again");
    const [length, named] = [view.getUint32(at + 18, true), view.getUint16(at + 26, true)];
    if (begin + named > bytes.length)
      throw new Malformed(WHOLE, "it ends in the middle of a member; ask for the file again");
    const name = text(bytes.subarray(begin, begin + named));
    if (name === undefined || !isName(name))
      throw new Malformed(WHOLE, "a member has a name that does not belong in a bundle");
    const end = begin + named + length;
    if (end > bytes.length) throw new Malformed(WHOLE, "it ends in the middle of a member; ask for the file again");
    if (members.has(name) || members.size >= MOST_MEMBERS) throw new Malformed(name, "is a duplicate, or one too many");
    const content = bytes.subarray(begin + named, end);
    const own = fields(name, content);
    if (!equal(bytes.subarray(at + 4, begin), own))
      throw new Malformed(
        WHOLE,
        "it is a ZIP archive, but not in the exact form of a bundle: it was repacked or damaged",
      );
    headers.push({ name, own, at });
    members.set(name, content);
    at = end;
    step(at);
  }
  if (!members.size) throw new Malformed(WHOLE, "it is not an evidence bundle");
  if (!isOrdered([...members.keys()]) || !equal(bytes.subarray(at), directory(headers, at))) {
    throw new Malformed(
      WHOLE,
      "it is a ZIP archive, but not in the exact form of a bundle: it was repacked or damaged",
    );
  }
  return members;
}

function isOrdered(names) {
  const rest = names[0] === FIRST ? names.slice(1) : names;
  return rest.every((name, at) => name !== FIRST && (at === 0 || rest[at - 1] < name));
}

/** The central directory of these members, and the end of the file. */
function directory(headers, begin) {
  const length = headers.reduce((sum, { name }) => sum + 46 + name.length, 0);
  const out = new Uint8Array(length + 22);
  const view = new DataView(out.buffer);
  let at = 0;
  for (const header of headers) {
    view.setUint32(at, CENTRAL, true);
    view.setUint16(at + 4, 10, true);
    out.set(header.own, at + 6);
    view.setUint32(at + 42, header.at, true);
    for (let letter = 0; letter < header.name.length; letter++) out[at + 46 + letter] = header.name.charCodeAt(letter);
    at += 46 + header.name.length;
  }
  view.setUint32(at, END, true);
  view.setUint16(at + 8, headers.length, true);
  view.setUint16(at + 10, headers.length, true);
  view.setUint32(at + 12, length, true);
  view.setUint32(at + 16, begin, true);
  return out;
}
