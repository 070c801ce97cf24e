// SM3 (GB/T 32905), and HMAC and HKDF-Expand (RFC 5869) over it.

const INITIAL = [0x7380166f, 0x4914b2b9, 0x172442d7, 0xda8a0600, 0xa96f30bc, 0x163138aa, 0xe38dee4d, 0xb0fb0e4e];
const ROUND = Int32Array.from({ length: 64 }, (_, round) => rotated(round < 16 ? 0x79cc4519 : 0x7a879d8a, round % 32));
const words = new Int32Array(68);

function rotated(word, by) {
  return (word << by) | (word >>> (32 - by));
}

function compress(state, bytes, at) {
  for (let j = 0; j < 16; j++, at += 4) {
    words[j] = (bytes[at] << 24) | (bytes[at + 1] << 16) | (bytes[at + 2] << 8) | bytes[at + 3];
  }
  for (let j = 16; j < 68; j++) {
    const mixed = words[j - 16] ^ words[j - 9] ^ rotated(words[j - 3], 15);
    words[j] = mixed ^ rotated(mixed, 15) ^ rotated(mixed, 23) ^ rotated(words[j - 13], 7) ^ words[j - 6];
  }
  let [a, b, c, d, e, f, g, h] = state;
  for (let j = 0; j < 64; j++) {
    const turned = rotated(a, 12);
    const first = rotated((turned + e + ROUND[j]) | 0, 7);
    const ff = j < 16 ? a ^ b ^ c : (a & b) | (a & c) | (b & c);
    const gg = j < 16 ? e ^ f ^ g : (e & f) | (~e & g);
    const one = (ff + d + (first ^ turned) + (words[j] ^ words[j + 4])) | 0;
    const two = (gg + h + first + words[j]) | 0;
    d = c;
    c = rotated(b, 9);
    b = a;
    a = one;
    h = g;
    g = rotated(f, 19);
    f = e;
    e = two ^ rotated(two, 9) ^ rotated(two, 17);
  }
  state[0] ^= a;
  state[1] ^= b;
  state[2] ^= c;
  state[3] ^= d;
  state[4] ^= e;
  state[5] ^= f;
  state[6] ^= g;
  state[7] ^= h;
}

/** Of the parts one after the other. */
export function sm3(...parts) {
  const state = Int32Array.from(INITIAL);
  const block = new Uint8Array(128);
  let length = 0;
  let filled = 0;
  for (const part of parts) {
    let at = 0;
    length += part.length;
    while (at < part.length) {
      if (filled === 0 && part.length - at >= 64) {
        compress(state, part, at);
        at += 64;
        continue;
      }
      const taken = Math.min(64 - filled, part.length - at);
      block.set(part.subarray(at, at + taken), filled);
      filled += taken;
      at += taken;
      if (filled === 64) {
        compress(state, block, 0);
        filled = 0;
      }
    }
  }
  block.fill(0, filled);
  block[filled] = 0x80;
  const end = filled < 56 ? 64 : 128;
  const view = new DataView(block.buffer);
  view.setUint32(end - 8, Math.floor(length / 0x20000000));
  view.setUint32(end - 4, length * 8);
  for (let at = 0; at < end; at += 64) compress(state, block, at);
  const out = new DataView(new ArrayBuffer(32));
  state.forEach((word, at) => out.setInt32(4 * at, word));
  return new Uint8Array(out.buffer);
}

export function hmacSm3(key, ...parts) {
  const padded = new Uint8Array(64);
  padded.set(key.length > 64 ? sm3(key) : key);
  const inner = sm3(
    padded.map((byte) => byte ^ 0x36),
    ...parts,
  );
  return sm3(
    padded.map((byte) => byte ^ 0x5c),
    inner,
  );
}

/** HKDF-Expand. */
export function expand(key, info, length) {
  const out = new Uint8Array(length);
  let block = new Uint8Array(0);
  for (let at = 0, number = 1; at < length; at += 32, number++) {
    block = hmacSm3(key, block, info, Uint8Array.of(number));
    out.set(block.subarray(0, Math.min(32, length - at)), at);
  }
  return out;
}
