"""SM3 (GB/T 32905), HMAC and HKDF over it, and Keccak-256. OpenSSL's SM3 where Python has it, for it is a thousand times faster."""
import hashlib
import struct

M32 = 0xFFFFFFFF


def rotl(x, n):
    n %= 32
    return ((x << n) | (x >> (32 - n))) & M32


def own_sm3(data):
    v = [0x7380166F, 0x4914B2B9, 0x172442D7, 0xDA8A0600, 0xA96F30BC, 0x163138AA, 0xE38DEE4D, 0xB0FB0E4E]
    data = bytes(data)
    data += b"\x80" + bytes((55 - len(data)) % 64) + struct.pack(">Q", len(data) * 8)
    p1 = lambda x: x ^ rotl(x, 15) ^ rotl(x, 23)
    for at in range(0, len(data), 64):
        w = list(struct.unpack(">16I", data[at:at + 64]))
        for j in range(16, 68):
            w.append(p1(w[j - 16] ^ w[j - 9] ^ rotl(w[j - 3], 15)) ^ rotl(w[j - 13], 7) ^ w[j - 6])
        a, b, c, d, e, f, g, h = v
        for j in range(64):
            ss1 = rotl((rotl(a, 12) + e + rotl(0x79CC4519 if j < 16 else 0x7A879D8A, j)) & M32, 7)
            ff = a ^ b ^ c if j < 16 else (a & b) | (a & c) | (b & c)
            gg = e ^ f ^ g if j < 16 else (e & f) | (~e & g)
            tt1 = (ff + d + (ss1 ^ rotl(a, 12)) + (w[j] ^ w[j + 4])) & M32
            tt2 = (gg + h + ss1 + w[j]) & M32
            a, b, c, d = tt1, a, rotl(b, 9), c
            e, f, g, h = tt2 ^ rotl(tt2, 9) ^ rotl(tt2, 17), e, rotl(f, 19), g
        v = [x ^ y for x, y in zip(v, (a, b, c, d, e, f, g, h))]
    return struct.pack(">8I", *v)


class GatheredSm3(bytearray):
    """A running hash where OpenSSL has none: all bytes, hashed at the end."""

    update = bytearray.extend
    digest = own_sm3


def running_sm3():
    try:
        return hashlib.new("sm3")
    except ValueError:
        return GatheredSm3()


def sm3(data):
    running = running_sm3()
    running.update(data)
    return running.digest()


def hmac_sm3(key, data):
    key = (sm3(key) if len(key) > 64 else key).ljust(64, b"\0")
    return sm3(bytes(b ^ 0x5C for b in key) + sm3(bytes(b ^ 0x36 for b in key) + data))


def expand(prk, info, length):
    """HKDF-Expand (RFC 5869)."""
    out, block = b"", b""
    for number in range(1, -(-length // 32) + 1):
        block = hmac_sm3(prk, block + info + bytes([number]))
        out += block
    return out[:length]


def keccak_constants():
    rotation, constants = {}, []
    x, y, bits = 1, 0, 1
    for t in range(24):
        rotation[x + 5 * y] = (t + 1) * (t + 2) // 2 % 64
        x, y = y, (2 * x + 3 * y) % 5
    for _ in range(24):
        constant = 0
        for j in range(7):
            constant ^= (1 << (2 ** j - 1)) if bits & 1 else 0
            bits = (bits << 1) ^ (0x171 if bits & 0x80 else 0)
        constants.append(constant)
    moves = [(i // 5 % 5 + 5 * ((2 * (i % 5) + 3 * (i // 5)) % 5), rotation.get(i, 0)) for i in range(25)]
    return moves, constants


MOVES, CONSTANTS = keccak_constants()
M64 = 2 ** 64 - 1


def keccak(data):
    """Keccak-256 in Ethereum's variant."""
    state = [0] * 25
    padded = bytearray(data + b"\1" + bytes(-(len(data) + 1) % 136))
    padded[-1] |= 0x80
    for at in range(0, len(padded), 136):
        for lane, value in enumerate(struct.unpack_from("<17Q", padded, at)):
            state[lane] ^= value
        for constant in CONSTANTS:
            c = [state[x] ^ state[x + 5] ^ state[x + 10] ^ state[x + 15] ^ state[x + 20] for x in range(5)]
            d = [c[(x + 4) % 5] ^ ((c[(x + 1) % 5] << 1 | c[(x + 1) % 5] >> 63) & M64) for x in range(5)]
            b = [0] * 25
            for i, (to, n) in enumerate(MOVES):
                v = state[i] ^ d[i % 5]
                b[to] = (v << n | v >> (64 - n)) & M64
            state = [b[i] ^ (~b[i - i % 5 + (i + 1) % 5] & b[i - i % 5 + (i + 2) % 5] & M64) for i in range(25)]
            state[0] ^= constant
    return struct.pack("<4Q", *state[:4])


assert keccak(b"").hex().startswith("c5d2460186f7233c")
assert own_sm3(b"abc").hex().startswith("66c7f0f462eeedd9") and sm3(b"abc") == own_sm3(b"abc")
