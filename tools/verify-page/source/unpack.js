// Packed messages: blocks of LZ4, and matrices of numbers (raw pictures, depth, clouds) behind filters and zlib.

import { Reader } from "./bytes.js";
import { Broken } from "./outcome.js";

export const LONGEST_MESSAGE = 64 * 2 ** 20;
/** The most bytes that LZ4, and Deflate, expand one byte to. */
const MOST_PER_LZ4_BYTE = 255;
const MOST_PER_MATRIX_BYTE = 1100;
const SHORTEST_ROW = 16;
const MOST_CHANNELS = 64;
const BIG_ENDIAN = 0x80;
const GREEN = 0x40;
const [PLAIN, LEFT, ABOVE, AVERAGE, PAETH] = [0, 1, 2, 3, 4];

const damaged = (field) => new Broken(`the ${field} has an invalid value`);

export function unpackLz4(packed, length) {
  const fail = () => damaged("compressed body");
  if (Math.floor(length / MOST_PER_LZ4_BYTE) > packed.length) throw fail();
  const out = new Uint8Array(length);
  let at = 0;
  let filled = 0;
  /** 15 in the token continues in bytes, 255 in a byte in the next. */
  const more = (count) => {
    for (let isMore = count === 15; isMore; at++) {
      if (at >= packed.length) throw fail();
      count += packed[at];
      isMore = packed[at] === 255;
    }
    return count;
  };
  for (;;) {
    if (at >= packed.length) throw fail();
    const token = packed[at++];
    const literals = more(token >> 4);
    if (literals > packed.length - at || literals > length - filled) throw fail();
    out.set(packed.subarray(at, at + literals), filled);
    at += literals;
    filled += literals;
    if (at === packed.length) break;
    if (at + 2 > packed.length) throw fail();
    const back = packed[at] | (packed[at + 1] << 8);
    at += 2;
    const count = more(token & 15) + 4;
    if (back === 0 || back > filled || count > length - filled) throw fail();
    if (back >= count) out.copyWithin(filled, filled - back, filled - back + count);
    else for (let byte = 0; byte < count; byte++) out[filled + byte] = out[filled + byte - back];
    filled += count;
  }
  if (filled !== length) throw fail();
  return out;
}

function readMatrix(reader) {
  const [start, rows, columns] = [0, 0, 0].map(() => reader.small(4, "matrix"));
  const [channels, code, apart] = [reader.small(1, "channels"), reader.small(1, "sample"), reader.small(1, "distance")];
  const sample = code & ~(BIG_ENDIAN | GREEN);
  const isGreen = (code & GREEN) !== 0;
  const row = columns * channels * sample;
  const isKnown =
    [1, 2, 4].includes(sample) && channels >= 1 && channels <= MOST_CHANNELS && (apart === 1 || apart === 2);
  const fits = row >= SHORTEST_ROW && Number.isSafeInteger(start + rows * row);
  if (!isKnown || !fits || (isGreen && (sample !== 1 || channels < 3))) throw damaged("matrix");
  const isBig = (code & BIG_ENDIAN) !== 0;
  return { start, rows, row, sample, isBig, apart, back: apart * channels, colours: isGreen ? channels : 0 };
}

export async function unpackMatrix(packed, length) {
  const reader = new Reader(packed);
  const matrix = readMatrix(reader);
  const end = matrix.start + matrix.rows * matrix.row;
  if (end > length) throw damaged("matrix");
  const before = reader.take(matrix.start, "matrix");
  const behind = reader.take(length - end, "matrix");
  if (Math.floor(length / MOST_PER_MATRIX_BYTE) > packed.length) throw damaged("matrix");
  const filtered = await inflate(reader.rest(), matrix.rows * (matrix.row + 1));
  const out = new Uint8Array(length);
  out.set(before);
  restore(matrix, filtered, out.subarray(matrix.start, end));
  out.set(behind, end);
  return out;
}

/** A zlib stream that unpacks to exactly the given length; no more is kept of a longer one. */
async function inflate(stream, length) {
  const out = new Uint8Array(length);
  let filled = 0;
  try {
    const source = new Blob([stream]).stream().pipeThrough(new DecompressionStream("deflate"));
    for await (const chunk of chunks(source.getReader())) {
      if (chunk.length > length - filled) throw damaged("matrix");
      out.set(chunk, filled);
      filled += chunk.length;
    }
  } catch {
    throw damaged("matrix");
  }
  if (filled !== length) throw damaged("matrix");
  return out;
}

async function* chunks(reader) {
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      yield value;
    }
  } finally {
    reader.cancel().catch(() => {});
  }
}

/** Undoes the filter of each row: of bytes as in PNG (ISO/IEC 15948, clause 9), of numbers by planes of differences. */
function restore(matrix, filtered, out) {
  const { rows, row, sample, apart } = matrix;
  const width = sample === 1 ? row : row / sample;
  const make = () => (sample === 1 ? new Uint8Array(width) : new Uint32Array(width));
  const kept = [make(), make()];
  for (let number = 0; number < rows; number++) {
    const from = number * (row + 1);
    const [kind, coded] = [filtered[from], filtered.subarray(from + 1, from + 1 + row)];
    const place = out.subarray(number * row, (number + 1) * row);
    const above = kept[apart - 1];
    const now = sample === 1 ? rowOfBytes(kind, coded, above, matrix) : rowOfNumbers(kind, coded, above, matrix);
    if (sample === 1) putBytes(now, place, matrix.colours);
    else putNumbers(now, place, matrix);
    kept.pop();
    kept.unshift(now);
  }
}

function paeth(left, above, corner) {
  const toLeft = Math.abs(above - corner);
  const toAbove = Math.abs(left - corner);
  const toCorner = Math.abs(left + above - 2 * corner);
  if (toLeft <= toAbove && toLeft <= toCorner) return left;
  return toAbove <= toCorner ? above : corner;
}

function rowOfBytes(kind, coded, above, { back }) {
  const now = Uint8Array.from(coded);
  if (kind > PAETH) throw damaged("matrix");
  if (kind === PLAIN) return now;
  for (let at = 0; at < now.length; at++) {
    const left = at < back ? 0 : now[at - back];
    if (kind === ABOVE) now[at] += above[at];
    else if (kind === LEFT) now[at] += left;
    else if (kind === AVERAGE) now[at] += (left + above[at]) >> 1;
    else now[at] += at < back ? above[at] : paeth(left, above[at], above[at - back]);
  }
  return now;
}

function rowOfNumbers(kind, coded, above, { sample, back }) {
  if (kind !== LEFT && kind !== ABOVE) throw damaged("matrix");
  const now = new Uint32Array(coded.length / sample);
  const mask = sample === 4 ? 0xffffffff : 0xffff;
  for (let at = 0; at < now.length; at++) {
    let number = 0;
    for (let plane = 0; plane < sample; plane++) number |= coded[plane * now.length + at] << (8 * plane);
    const difference = (number >>> 1) ^ -(number & 1);
    const left = at < back ? 0 : now[at - back];
    now[at] = ((kind === ABOVE ? above[at] : left) + difference) & mask;
  }
  return now;
}

function putBytes(now, place, colours) {
  place.set(now);
  for (let at = 0; colours && at + colours <= place.length; at += colours) {
    place[at] += place[at + 1];
    place[at + 2] += place[at + 1];
  }
}

function putNumbers(now, place, { sample, isBig }) {
  const view = new DataView(place.buffer, place.byteOffset, place.length);
  now.forEach((number, at) => {
    if (sample === 2) view.setUint16(2 * at, number, !isBig);
    else view.setUint32(4 * at, number, !isBig);
  });
}
