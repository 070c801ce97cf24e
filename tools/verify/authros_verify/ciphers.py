"""SM4 (GB/T 32907), and GCM over it (NIST SP 800-38D, RFC 8998)."""
import hmac
import struct

from .errors import Refused
from .hashes import rotl


def sbox():
    """Affine, inversion modulo x^8 + x^7 + x^6 + x^5 + x^4 + x^2 + 1, affine."""
    def times(a, b):
        product = 0
        while b:
            product ^= a if b & 1 else 0
            a, b = (a << 1) ^ (0x1F5 if a & 0x80 else 0), b >> 1
        return product

    def affine(x):
        return sum((bin(x & row).count("1") & 1) << (7 - at) for at, row in enumerate(rows)) ^ 0xD3

    rows = [(0xD3 >> at | 0xD3 << (8 - at)) & 0xFF for at in range(8)]
    inverse = {0: 0}
    inverse.update({a: b for a in range(1, 256) for b in range(1, 256) if times(a, b) == 1})
    return [affine(inverse[affine(x)]) for x in range(256)]


SBOX = sbox()
assert (SBOX[0x00], SBOX[0x01], SBOX[0xEF], SBOX[0xFF]) == (0xD6, 0x90, 0x84, 0x48), "SM4's S-box"


def tau(x):
    return SBOX[x >> 24] << 24 | SBOX[x >> 16 & 255] << 16 | SBOX[x >> 8 & 255] << 8 | SBOX[x & 255]


def sm4_keys(key):
    k = [a ^ b for a, b in zip(struct.unpack(">4I", key), (0xA3B1BAC6, 0x56AA3350, 0x677D9197, 0xB27022DC))]
    for i in range(32):
        ck = int.from_bytes(bytes((4 * i + j) * 7 % 256 for j in range(4)), "big")
        b = tau(k[i + 1] ^ k[i + 2] ^ k[i + 3] ^ ck)
        k.append(k[i] ^ b ^ rotl(b, 13) ^ rotl(b, 23))
    return k[4:]


def sm4(keys, block):
    x = list(struct.unpack(">4I", block))
    for rk in keys:
        b = tau(x[1] ^ x[2] ^ x[3] ^ rk)
        x = x[1:] + [x[0] ^ b ^ rotl(b, 2) ^ rotl(b, 10) ^ rotl(b, 18) ^ rotl(b, 24)]
    return struct.pack(">4I", *reversed(x))


def multiples(h):
    """For each nibble at the low end of a number the product of it and x^4."""
    shifted = []
    for nibble in range(16):
        v = nibble
        for _ in range(4):
            v = (v >> 1) ^ (0xE1 << 120 if v & 1 else 0)
        shifted.append(v)
    table = [0] * 16
    v = h
    for bit in (8, 4, 2, 1):
        table[bit], v = v, (v >> 1) ^ (0xE1 << 120 if v & 1 else 0)
    for nibble in range(16):
        table[nibble] = table[nibble & 8] ^ table[nibble & 4] ^ table[nibble & 2] ^ table[nibble & 1]
    return table, shifted


def ghash(h, data):
    table, shifted = multiples(h)
    y = 0
    for at in range(0, len(data), 16):
        x, y = y ^ int.from_bytes(data[at:at + 16], "big"), 0
        for place in range(0, 128, 4):
            y = (y >> 4) ^ shifted[y & 15] ^ table[x >> place & 15]
    return y.to_bytes(16, "big")


def gcm_open(key, nonce, aad, sealed):
    keys = sm4_keys(key)
    h = int.from_bytes(sm4(keys, bytes(16)), "big")
    text, tag = sealed[:-16], sealed[-16:]
    pad = lambda data: data + bytes(-len(data) % 16)
    hashed = ghash(h, pad(aad) + pad(text) + struct.pack(">2Q", len(aad) * 8, len(text) * 8))
    if not hmac.compare_digest(tag, bytes(a ^ b for a, b in zip(sm4(keys, nonce + b"\0\0\0\1"), hashed))):
        raise Refused("bad_disclosure", "a tag does not hold")
    stream = b"".join(sm4(keys, nonce + struct.pack(">I", n + 2)) for n in range(-(-len(text) // 16)))
    return bytes(a ^ b for a, b in zip(text, stream))
