#!/usr/bin/env python3
"""A second verifier of evidence bundles, written from docs/format.md, section 11, with nothing but Python's standard library.

    verify.py NAME.authros [--trust trust.toml] [--recording FILE]

It says of each record whether level (a), (b), (c) and (e) are proven, own_chain, unproven, absent or refused, and of each topic
what (f) comes to, as JSON, and ends with 0 where (a) to (c) are proven for all by what was pinned and the exporter's key is that
of their owner or pinned, 8 where something is not proven or holds by the exporter's self-sealed chain alone, 6 where something is refused, 3 where the trust file cannot be used. It is
slow, on purpose: it can be read in one sitting. A recorded file is compared with what an opened record states of it. Bodies packed by the matrix code are opened and not unpacked, and it says so.
"""
import base64
import functools
import hashlib
import hmac
import json
import pathlib
import re
import struct
import sys
import tomllib
import zlib


class Refused(Exception):
    """Something is contradicted."""


class Unproven(Exception):
    """Something that would prove it is missing."""


M32 = 0xFFFFFFFF


def rotl(x, n):
    n %= 32
    return ((x << n) | (x >> (32 - n))) & M32


def sm3(data):  # GB/T 32905
    v = [0x7380166F, 0x4914B2B9, 0x172442D7, 0xDA8A0600, 0xA96F30BC, 0x163138AA, 0xE38DEE4D, 0xB0FB0E4E]
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


def hmac_sm3(key, data):
    key = (sm3(key) if len(key) > 64 else key).ljust(64, b"\0")
    return sm3(bytes(b ^ 0x5C for b in key) + sm3(bytes(b ^ 0x36 for b in key) + data))


def expand(prk, info, length):  # RFC 5869
    out, block = b"", b""
    for number in range(1, -(-length // 32) + 1):
        block = hmac_sm3(prk, block + info + bytes([number]))
        out += block
    return out[:length]


def keccak(data):  # Keccak-256, in Ethereum's variant
    rotation, constants, state = {}, [], [0] * 25
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
    mask = 2 ** 64 - 1
    turn = lambda v, n: ((v << n) | (v >> (64 - n))) & mask
    padded = bytearray(data + b"\1" + bytes(-(len(data) + 1) % 136))
    padded[-1] |= 0x80
    for at in range(0, len(padded), 136):
        for lane in range(17):
            state[lane] ^= int.from_bytes(padded[at + 8 * lane:at + 8 * lane + 8], "little")
        for constant in constants:
            c = [state[x] ^ state[x + 5] ^ state[x + 10] ^ state[x + 15] ^ state[x + 20] for x in range(5)]
            state = [state[i] ^ c[(i + 4) % 5] ^ turn(c[(i + 1) % 5], 1) for i in range(25)]
            b = [0] * 25
            for i in range(25):
                x, y = i % 5, i // 5
                b[y + 5 * ((2 * x + 3 * y) % 5)] = turn(state[i], rotation.get(i, 0))
            state = [b[i] ^ (~b[i // 5 * 5 + (i + 1) % 5] & b[i // 5 * 5 + (i + 2) % 5] & mask) for i in range(25)]
            state[0] ^= constant
    return b"".join(lane.to_bytes(8, "little") for lane in state[:4])


assert keccak(b"").hex().startswith("c5d2460186f7233c") and sm3(b"abc").hex().startswith("66c7f0f462eeedd9")


def sbox():  # GB/T 32907: affine, inversion modulo x^8 + x^7 + x^6 + x^5 + x^4 + x^2 + 1, affine
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
    return int.from_bytes(bytes(SBOX[b] for b in x.to_bytes(4, "big")), "big")


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


def gcm_open(key, nonce, aad, sealed):  # NIST SP 800-38D over SM4, RFC 8998
    keys = sm4_keys(key)
    h = int.from_bytes(sm4(keys, bytes(16)), "big")

    def times(x):
        product, v = 0, h
        for bit in range(127, -1, -1):
            product ^= v if x >> bit & 1 else 0
            v = (v >> 1) ^ (0xE1 << 120 if v & 1 else 0)
        return product

    text_, tag = sealed[:-16], sealed[-16:]
    pad = lambda data: data + bytes(-len(data) % 16)
    y, hashed = 0, pad(aad) + pad(text_) + struct.pack(">2Q", len(aad) * 8, len(text_) * 8)
    for at in range(0, len(hashed), 16):
        y = times(y ^ int.from_bytes(hashed[at:at + 16], "big"))
    first = sm4(keys, nonce + b"\0\0\0\1")
    if not hmac.compare_digest(tag, bytes(a ^ b for a, b in zip(first, y.to_bytes(16, "big")))):
        raise Refused("a tag does not hold")
    stream = b"".join(sm4(keys, nonce + struct.pack(">I", n + 2)) for n in range(-(-len(text_) // 16)))
    return bytes(a ^ b for a, b in zip(text_, stream))


# GB/T 32918: the recommended curve.
P = 0xFFFFFFFEFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFF00000000FFFFFFFFFFFFFFFF
A = P - 3
B = 0x28E9FA9E9D9F5E344D5A9E4BCF6509A7F39789F515AB8F92DDBCBD414D940E93
N = 0xFFFFFFFEFFFFFFFFFFFFFFFFFFFFFFFF7203DF6B21C6052B53BBF40939D54123
G = (0x32C4AE2C1F1981195F9904466A39C9948FE30BBFF2660BE1715A4589334C74C7,
     0xBC3736A2F4F6779C59BDCEE36B692153D0A9877CC62A474002DF32E52139F0A0)


def add(p, q, a, modulus):
    if p is None or q is None:
        return p or q
    if p[0] == q[0] and (p[1] + q[1]) % modulus == 0:
        return None
    rise, run = (3 * p[0] * p[0] + a, 2 * p[1]) if p == q else (q[1] - p[1], q[0] - p[0])
    slope = rise * pow(run, -1, modulus) % modulus
    x = (slope * slope - p[0] - q[0]) % modulus
    return x, (slope * (p[0] - x) - p[1]) % modulus


def mul(k, p, a, modulus):
    total = None
    while k:
        total, p, k = add(total, p, a, modulus) if k & 1 else total, add(p, p, a, modulus), k >> 1
    return total


def is_point(public):
    x, y = (int.from_bytes(public[at:at + 32], "big") for at in (0, 32))
    return max(x, y) < P and (y ** 2 - x ** 3 - A * x - B) % P == 0


def sm2_verify(public, message, der):
    try:
        r, s = der_numbers(der)
    except (IndexError, ValueError):
        return False
    if not is_point(public):
        return False
    point = tuple(int.from_bytes(public[at:at + 32], "big") for at in (0, 32))
    number = lambda x: x.to_bytes(32, "big")
    name = b"1234567812345678"
    z = sm3(struct.pack(">H", len(name) * 8) + name + b"".join(map(number, (A, B, *G, *point))))
    e = int.from_bytes(sm3(z + message), "big")
    t = (r + s) % N
    if not (0 < r < N and 0 < s < N and t):
        return False
    sum_ = add(mul(s, G, A, P), mul(t, point, A, P), A, P)
    return sum_ is not None and (e + sum_[0]) % N == r


def der_numbers(der):  # SEQUENCE of two INTEGERs, in DER's only form
    if der[0] != 0x30 or der[1] != len(der) - 2:
        raise ValueError("no signature")
    numbers, rest = [], der[2:]
    for _ in range(2):
        if rest[0] != 2 or not 0 < rest[1] <= 33 or len(rest) < 2 + rest[1]:
            raise ValueError("no signature")
        value, rest = rest[2:2 + rest[1]], rest[2 + rest[1]:]
        if value[0] & 0x80 or (len(value) > 1 and value[0] == 0 and not value[1] & 0x80):
            raise ValueError("no signature")
        numbers.append(int.from_bytes(value, "big"))
    if rest:
        raise ValueError("no signature")
    return numbers


def recover(hash_, seal):  # secp256k1: the account whose key made a seal
    p = 2 ** 256 - 2 ** 32 - 977
    order = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141
    g = (0x79BE667EF9DCBBAC55A06295CE870B07029BFCDB2DCE28D959F2815B16F81798,
         0x483ADA7726A3C4655DA4FBFC0E1108A8FD17B448A68554199C47D08FFB10D4B8)
    r, s, parity = int.from_bytes(seal[:32], "big"), int.from_bytes(seal[32:64], "big"), seal[64]
    square = (pow(r, 3, p) + 7) % p
    y = pow(square, (p + 1) // 4, p)
    if parity > 1 or not 0 < r < order or not 0 < s <= order // 2 or y * y % p != square:
        return None
    point, inverse = (r, y if y & 1 == parity else p - y), pow(r, -1, order)
    e = int.from_bytes(hash_, "big")
    key = add(mul(s * inverse % order, point, 0, p), mul(-e * inverse % order, g, 0, p), 0, p)
    return None if key is None else keccak(key[0].to_bytes(32, "big") + key[1].to_bytes(32, "big"))[12:]


DEEPEST = 32


def rlp(data):  # one item: bytes or a list, each length in its one form; its source is hashed elsewhere
    def item(at, depth):
        first = data[at]
        if first < 0x80:
            return data[at:at + 1], at + 1
        short, base = (first < 0xB8, 0x80) if first < 0xC0 else (first < 0xF8, 0xC0)
        size, begin = first - base, at + 1
        if not short:
            begin += size - 55
            size = int.from_bytes(data[at + 1:begin], "big")
        end = begin + size
        if end > len(data):
            raise Refused("RLP ends too early")
        if first < 0xC0:
            return data[begin:end], end
        found, at = [], begin
        while at < end:
            if depth == DEEPEST:
                raise Refused("lists of RLP lie too deep")
            one, at = item(at, depth + 1)
            found.append(one)
        return found, end

    found, end = item(0, 0)
    if end != len(data) or encode(found) != data:
        raise Refused("RLP is not of its one form")
    return found


def number(item):  # as RLP has it, of at most 64 bits
    if not isinstance(item, bytes) or len(item) > 8 or item[:1] == b"\0":
        raise Refused("a number in RLP is malformed")
    return int.from_bytes(item, "big")


def encode(item):
    body = item if isinstance(item, bytes) else b"".join(map(encode, item))
    base = 0x80 if isinstance(item, bytes) else 0xC0
    if base == 0x80 and len(body) == 1 and body[0] < 0x80:
        return body
    if len(body) < 56:
        return bytes([base + len(body)]) + body
    size = len(body).to_bytes((len(body).bit_length() + 7) // 8, "big")
    return bytes([base + 55 + len(size)]) + size + body


EMPTY = keccak(b"\x80")


def look_up(nodes, root, key):  # Yellow Paper, appendices C and D
    if root == EMPTY:
        return None
    if not isinstance(root, bytes) or len(root) != 32:
        raise Refused("the root of a trie is malformed")
    path = [nibble for byte in keccak(key) for nibble in (byte >> 4, byte & 15)]
    at = root
    while True:
        if isinstance(at, bytes):
            if at == b"":
                return None
            if len(at) != 32:
                raise Refused("the node on its path is not a trie node")
            if at not in nodes:
                raise Unproven("a node of the state is not in the bundle")
            at = rlp(nodes[at])
        if not isinstance(at, list) or len(at) not in (2, 17) or (len(at) == 2 and not (isinstance(at[0], bytes) and at[0] and at[0][0] < 0x40)):
            raise Refused("the node on its path is not a trie node")
        if len(at) == 17:
            if not path:
                return None
            at, path = at[path[0]], path[1:]
            continue
        packed = [nibble for byte in at[0] for nibble in (byte >> 4, byte & 15)]
        own = packed[2 - (packed[0] & 1):]
        if path[:len(own)] != own:
            return None
        path = path[len(own):]
        if packed[0] & 2:
            if not isinstance(at[1], bytes):
                raise Refused("the node on its path is not a trie node")
            return None if path else at[1]
        if not own:
            raise Refused("the node on its path is not a trie node")
        at = at[1]


pad = lambda value: (value.to_bytes(8, "big") if isinstance(value, int) else value).rjust(32, b"\0")
mapped = lambda key, below: keccak(pad(key) + pad(below))


class Storage:
    def __init__(self, nodes, state, contract):
        account = look_up(nodes, state, contract)
        if account is None:
            raise Refused("the state has no contract at that address")
        fields_ = rlp(account)
        if not isinstance(fields_, list) or len(fields_) != 4 or any(not isinstance(one, bytes) or len(one) != 32 for one in fields_[2:]):
            raise Refused("what the state holds there is no account")
        self.root, self.code = fields_[2:]
        self.nodes = nodes

    def word(self, slot):
        value = look_up(self.nodes, self.root, slot)
        word = rlp(value) if value is not None else b""
        if not isinstance(word, bytes) or len(word) > 32:
            raise Refused("what the state holds there is no word")
        return pad(word)

    def numbers(self, slot):  # four eight-byte numbers, from the low end
        return struct.unpack(">4Q", self.word(slot))[::-1]

    def keys(self, owner, version):
        slot = mapped(version, mapped(owner, 15))
        after = ((int.from_bytes(slot, "big") + 1) % 2 ** 256).to_bytes(32, "big")
        identity = self.word(slot)
        return (identity, self.numbers(after)[0]) if identity != bytes(32) else None


LARGEST_MESSAGE = 64 * 2 ** 20


def lz4(packed, plain_length):  # the block format of LZ4
    if not len(packed) < plain_length <= LARGEST_MESSAGE:
        raise Refused("the message has another length")
    out, at = bytearray(), 0

    def more(length):  # 15 in the token continues in bytes, 255 in a byte continues in the next
        nonlocal at
        goes_on = length == 15
        while goes_on:
            length, goes_on, at = length + packed[at], packed[at] == 255, at + 1
        return length

    try:
        while True:
            token, at = packed[at], at + 1
            literals = more(token >> 4)
            if literals > len(packed) - at or literals > plain_length - len(out):
                raise Refused("the packed message is cut off, or longer than it says")
            out += packed[at:at + literals]
            at += literals
            if at == len(packed):
                break
            back, at = packed[at] | packed[at + 1] << 8, at + 2
            length = more(token & 15) + 4
            if not 0 < back <= len(out) or length > plain_length - len(out):
                raise Refused("the packed message points to where nothing is, or is longer than it says")
            piece = bytes(out[-back:])
            out += (piece * (length // back + 1))[:length]
    except IndexError:
        raise Refused("the packed message is cut off") from None
    if len(out) != plain_length:
        raise Refused("the message has another length")
    return bytes(out)


def fields(data, *widths):
    at = 0
    for width in widths:
        yield data[at:at + width]
        at += width


def parse_header(record):
    if record[:10] != b"\x89AuthROS\x01\x01":
        raise Refused("not a record of this version and suite")
    names = ("kind", "domain", "owner", "signer", "epoch", "recorder", "seq", "topic_id", "count")
    header = dict(zip(names, fields(record[10:], 1, 32, 20, 32, 8, 16, 8, 16, 1)))
    at = 10 + 134
    header["filters"] = [record[at + 8 * n:at + 8 * n + 8] for n in range(header["count"][0])]
    at += 8 * len(header["filters"])
    names = ("time", "head_length", "body_length", "salt", "commit")
    header.update(zip(names, fields(record[at:], 8, 4, 8, 24, 32)))
    number = {name: int.from_bytes(header[name], "big") for name in ("epoch", "seq", "time")}
    if not 1 <= number["epoch"] < 1 << 63 or not 1 <= number["seq"] <= 1 << 40 or number["time"] >= 1 << 63:
        raise Refused("an epoch, number or time that no record has")
    # Kind (1: a ledger, 2: a ring), seven random bytes, and a tag of the key that signs.
    if header["recorder"][0] not in (1, 2) or header["recorder"][8:] != header["signer"][:8]:
        raise Refused("its recorder is not of the key that signs")
    return header, at + 76


def parse_head(head):
    at = 0

    def take(length):
        nonlocal at
        at += length
        return head[at - length:at]

    def word():
        return take(struct.unpack(">H", take(2))[0]).decode()

    found = {name: word() for name in ("topic", "type", "md5sum")}
    found["definition"], found["caller_id"], found["boot_id"] = take(32).hex(), word(), take(16).hex()
    found["compression"], found["plain_length"] = take(1)[0], int.from_bytes(take(8), "big")
    found["tags"] = {word(): word() for _ in range(int.from_bytes(take(2), "big"))}
    if at != len(head):
        raise Refused("bytes behind the head")
    return found


def root_of(leaf, index, count, path):  # RFC 9162, 2.1.3.2
    place, last, h = index, count - 1, leaf
    for p in path:
        if last == 0:
            return None
        if place & 1 or place == last:
            h = sm3(b"\1" + p + h)
            while place & 1 == 0 and place:
                place, last = place >> 1, last >> 1
        else:
            h = sm3(b"\1" + h + p)
        place, last = place >> 1, last >> 1
    return h if last == 0 else None


unhex = lambda text: bytes.fromhex(text.removeprefix("0x"))


LARGEST_ARCHIVE = 256 * 2 ** 20


def unpacked(data):
    """The members of an archive of the one form: what is read is written again and compared."""
    members, at = {}, 0
    while data[at:at + 4] == b"PK\3\4":
        size, _, named, extra = struct.unpack("<IIHH", data[at + 18:at + 30])
        name, begin = data[at + 30:at + 30 + named].decode("ascii"), at + 30 + named
        at = begin + size
        if at > len(data) or extra or name in members or len(members) == 60_000:
            raise Refused("the archive is not of the one form")
        members[name] = data[begin:at]
    if not members or packed(members) != data:
        raise Refused("the archive is not of the one form")
    return members


def packed(members):
    parts, central, at = [], [], 0
    for name in ["mimetype"] + sorted(set(members) - {"mimetype"}):
        content = members[name]
        same = struct.pack("<5H3I2H", 10, 0, 0, 0, 0x21, zlib.crc32(content), len(content), len(content), len(name), 0)
        central += [b"PK\1\2" + struct.pack("<H", 10), same, bytes(10), struct.pack("<I", at), name.encode()]
        parts += [b"PK\3\4", same, name.encode(), content]
        at += 30 + len(name) + len(content)
    listed = b"".join(central)
    end = struct.pack("<4H2IH", 0, 0, len(members), len(members), len(listed), at, 0)
    return b"".join(parts) + listed + b"PK\5\6" + end


def read_strictly(data):
    """JSON in one spelling: UTF-8, each line of an object once, whole numbers only. Python alone would also take others."""
    def distinct(pairs):
        if len({name for name, _ in pairs}) != len(pairs):
            raise Refused("a line is twice in JSON")
        return dict(pairs)

    def other(text):
        raise Refused(text + " in JSON is no whole number")

    whole = lambda text: other(text) if text.startswith("-") else int(text)
    return json.loads(data.decode(), object_pairs_hook=distinct, parse_int=whole, parse_float=other, parse_constant=other)


@functools.cache
def is_account(text):
    """0x and 40 digits; capital letters among small ones are its checksum (EIP-55)."""
    if not re.fullmatch("0x[0-9a-fA-F]{40}", text):
        return False
    digits, small = text[2:], text[2:].lower()
    checked = "".join(one.upper() if int(by, 16) >= 8 else one for one, by in zip(small, keccak(small.encode()).hex()))
    return digits in (small, small.upper(), checked)


ACCOUNT = 20
SUITE = {"name": "SM/1", "signature": "SM2-SM3", "digest": "SM3", "cipher": "SM4-GCM", "kdf": "HKDF-SM3", "chain": "Keccak-256"}
PLACE = {"root": 32, "index": int, "path": [32]}
# The lines of each JSON member: a number of bytes stands for hex of so many, a tuple for one form or another.
JSON_FORMS = {
    "manifest.json": {"format": str, "suite": dict.fromkeys(SUITE, str), "chain": {"id": int, "genesis": 32, "contract": ACCOUNT}, "exporter": {"account": ACCOUNT, "key": 32},
                      "members": [{"name": str, "bytes": int, "sm3": 32, "sha256": 32}]},
    "heights.json": {"format": str, "heights": [{"heads": 32, "topic": 16, "number": int, "index": int, "path": [32]}]},
    "records": {"format": str, "block": int, "shown_at": int, "keys": int,
                "anchor": ({"mode": str}, {"mode": str, "account": ACCOUNT, "root": 32, "index": int, "count": int, "path": [32]})},
    "stamps": {"format": str, "top": 32, "count": int, "roots": [PLACE]},
}


def has_form(found, form):
    if isinstance(form, tuple):
        return any(has_form(found, one) for one in form)
    if isinstance(form, dict):
        return isinstance(found, dict) and set(found) == set(form) and all(has_form(found[name], form[name]) for name in form)
    if isinstance(form, list):
        return isinstance(found, list) and all(has_form(one, form[0]) for one in found)
    if form in (int, str):
        return type(found) is form and (form is str or found < 2 ** 64)
    if not isinstance(found, str):
        return False
    return is_account(found) if form == ACCOUNT else re.fullmatch("(0x)?[0-9a-fA-F]{%d}" % (2 * form), found) is not None


class Bundle:
    FORMS = re.compile(r"mimetype|manifest\.(json|der)|trust\.toml|VERIFY\.txt|report\.html|chain/(nodes|[0-9]+)\.rlp|"
                       r"heights\.json|stamps/[0-9a-f]{64}/(roots\.json|[0-9a-f]{32}\.der)|keys/[0-9a-f]{64}\.pem|identities/[0-9a-f]{64}\.bin|definitions/[0-9a-f]{64}\.txt|"
                       r"records/[0-9a-f]{64}/(record\.bin|signature\.der|anchor\.json)|disclosed\.(bin|der)")

    def __init__(self, path):
        with open(path, "rb") as file:
            data = file.read(LARGEST_ARCHIVE + 1)
        if len(data) > LARGEST_ARCHIVE:
            raise Refused("it is longer than any bundle can be")
        self.members, self.plain_left, self.known = unpacked(data), 256 * 2 ** 20, {}
        names = list(self.members)
        large = lambda name: name in ("manifest.json", "heights.json", "disclosed.bin", "chain/nodes.rlp") or name.endswith(("/record.bin", "/roots.json"))
        if not all(self.FORMS.fullmatch(n) and (large(n) or len(d) <= (2 ** 24 if n == "report.html" else 65_536)) for n, d in self.members.items()):
            raise Refused("something is in the archive that a bundle does not hold")
        if len({name.split("/")[1] for name in names if name.startswith("records/")}) > 10_000:
            raise Refused("it has too many records")
        if self.members["mimetype"] != b"application/vnd.authros.evidence+zip":
            raise Refused("not an evidence bundle")
        text = self.members["manifest.json"]
        self.manifest = json.loads(text)
        of_form = lambda found, *names: set(found) == set(names)
        if not (of_form(self.manifest, "format", "suite", "chain", "exporter", "members") and of_form(self.manifest["exporter"], "account", "key")
                and of_form(self.manifest["chain"], "id", "genesis", "contract")
                and all(of_form(member, "name", "bytes", "sm3", "sha256") for member in self.manifest["members"])):
            raise Refused("the manifest has not the lines of its form")
        if self.manifest["suite"] != SUITE:
            raise Refused("the manifest names another suite")
        listed = {name for name in names if name not in ("mimetype", "manifest.json", "manifest.der")}
        if self.manifest["format"] != "authros-evidence/1" or [m["name"] for m in self.manifest["members"]] != sorted(listed):
            raise Refused("the manifest does not name the members")
        for member in self.manifest["members"]:
            data = self.members[member["name"]]
            found = len(data), sm3(data), hashlib.sha256(data).digest()
            if found != (member["bytes"], unhex(member["sm3"]), unhex(member["sha256"])):
                raise Refused(member["name"] + " does not match the manifest")
        self.keys = {name[5:69]: self.pem(data) for name, data in self.members.items() if name.startswith("keys/")}
        if any(sm3(b"\4" + key).hex() != name for name, key in self.keys.items()):
            raise Refused("a key is filed under another's name")
        of = lambda folder: {n: d for n, d in self.members.items() if n.startswith(folder)}
        self.identities = {keccak(data): data for data in of("identities/").values()}
        if any(keccak(data).hex() != name[11:75] or len(data) != 224 for name, data in of("identities/").items()):
            raise Refused("an identity is malformed, or filed under another's name")
        if any(sm3(data).hex() != name[12:76] for name, data in of("definitions/").items()):
            raise Refused("a definition is filed under another's name")
        for data in [*of("definitions/").values(), self.members.get("trust.toml", b"")]:
            data.decode()  # text, or refused
        self.headers = {int(n[6:-4]): self.header(n, d) for n, d in of("chain/").items() if n != "chain/nodes.rlp"}
        for name, data in of("records/").items():
            if name.endswith("anchor.json"):
                self.anchor_of_form(json.loads(data))
        self.secrets = self.listed_secrets()
        self.heights = self.listed_heights()
        self.stamped = self.listed_stamps()
        nodes = rlp(self.members["chain/nodes.rlp"]) if "chain/nodes.rlp" in self.members else []
        if any(not isinstance(node, bytes) or len(node) > 1024 for node in nodes):
            raise Refused("a node of the state is longer than any node")
        if "chain/nodes.rlp" in self.members and encode(nodes) != self.members["chain/nodes.rlp"]:
            raise Refused("the nodes of the state are not written in the one form")
        self.nodes = {keccak(node): node for node in nodes}
        if list(self.nodes) != sorted(self.nodes) or len(self.nodes) != len(nodes):
            raise Refused("the nodes of the state are not distinct and in order of their hashes")
        for name, data in self.members.items():
            if name.endswith(".json") and not has_form(read_strictly(data), JSON_FORMS[name.split("/")[0]]):
                raise Refused(name + " is not of its form")
        key, kind = self.keys.get(unhex(self.manifest["exporter"]["key"]).hex()), b"application/vnd.authros.evidence+zip"
        signed = b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(text), text)
        if key is None or not sm2_verify(key, signed, self.members["manifest.der"]):
            raise Refused("the manifest is not signed by its exporter's key")

    def listed_secrets(self):
        """The secrets of the disclosed records, by digest."""
        listed, signature = self.members.get("disclosed.bin"), self.members.get("disclosed.der")
        if listed is None and signature is None:
            return {}
        if not listed or signature is None or len(listed) % 64 or len(listed) > 640_000:
            raise Refused("the disclosure is not whole")
        try:
            der_numbers(signature)
        except (IndexError, ValueError):
            raise Refused("the disclosure's signature is malformed") from None
        pairs = [(listed[at:at + 32], listed[at + 32:at + 64]) for at in range(0, len(listed), 64)]
        if any(one[0] >= after[0] for one, after in zip(pairs, pairs[1:])):
            raise Refused("the disclosure is not in the order of its digests")
        if any(f"records/{digest.hex()}/record.bin" not in self.members for digest, _ in pairs):
            raise Refused("the disclosure names a record that is not in the bundle")
        return dict(pairs)

    def listed_stamps(self):
        """Under which imprints roots of batches are, and whether their paths lead there."""
        found, folders = {}, {name.split("/")[1] for name in self.members if name.startswith("stamps/")}
        if len(folders) > 10_000:
            raise Refused("it has too many time stamps")
        for folder in sorted(folders):
            tokens = [n for n in self.members if n.startswith(f"stamps/{folder}/") and n.endswith(".der")]
            if f"stamps/{folder}/roots.json" not in self.members:
                raise Refused("a time stamp has no roots with it")
            listed = json.loads(self.members[f"stamps/{folder}/roots.json"])
            count, top, roots = listed["count"], unhex(listed["top"]), listed["roots"]
            named = hashlib.sha256(b"AuthROS/stamp/1" + top + struct.pack(">Q", count)).hexdigest() == folder
            if listed["format"] != "authros-stamp/1" or not named or len(top) != 32 or not 1 <= len(tokens) <= 4 or count > 16_384:
                raise Refused("a time stamp is malformed")
            if any(hashlib.sha256(self.members[n]).hexdigest()[:32] != n.split("/")[2][:-4] for n in tokens):
                raise Refused("a token is filed under another's name")
            if len(roots) > 16_384 or any(len(one["path"]) > 14 for one in roots):
                raise Refused("a time stamp is malformed")
            if any(unhex(one["root"]) >= unhex(next_["root"]) for one, next_ in zip(roots, roots[1:])):
                raise Refused("roots of a time stamp are not in order")
            for one in roots:
                root, path = unhex(one["root"]), [unhex(step) for step in one["path"]]
                leads = one["index"] < count and root_of(sm3(b"\0AuthROS/stamp/1" + root), one["index"], count, path) == top
                found.setdefault(root, []).append((folder, leads))
        return found

    def listed_heights(self):
        """Heads, topics, highest numbers and paths, as the exporter lists them."""
        if "heights.json" not in self.members:
            return []
        listed = json.loads(self.members["heights.json"])
        if set(listed) != {"format", "heights"} or listed["format"] != "authros-heights/1" or len(listed["heights"]) > 10_000:
            raise Refused("heights.json is malformed")
        found = []
        for one in listed["heights"]:
            heads, topic, path = unhex(one["heads"]), unhex(one["topic"]), [unhex(step) for step in one["path"]]
            whole = all(type(one[name]) is int and 0 <= one[name] < 2 ** 64 for name in ("number", "index"))
            if len(one) != 5 or not whole or (len(heads), len(topic)) != (32, 16) or len(path) > 14 or any(len(s) != 32 for s in path):
                raise Refused("heights.json is malformed")
            found.append((heads, topic, one["number"], one["index"], path))
        return found

    @staticmethod
    def pem(data):  # SubjectPublicKeyInfo of SM2's curve; its last 64 bytes are the point
        info = base64.b64decode(b"".join(line for line in data.split(b"\n") if b"-" not in line))
        if info[:-64] != bytes.fromhex("3059301306072a8648ce3d020106082a811ccf5501822d03420004"):
            raise Refused("a key is not an SM2 public key")
        text = base64.b64encode(info)
        lines = [b"-----BEGIN PUBLIC KEY-----", text[:64], text[64:], b"-----END PUBLIC KEY-----"]
        if data != b"\n".join(lines) + b"\n" or not is_point(info[-64:]):
            raise Refused("a key is not an SM2 public key")
        return info[-64:]

    @staticmethod
    def header(name, data):
        """The header of a block, which is filed under its number."""
        found = rlp(data)
        if len(data) > 8192 or not isinstance(found, list) or not 15 <= len(found) <= 32:
            raise Refused("a header is malformed, or longer than any header")
        texts = all(isinstance(found[at], bytes) for at in (0, 3, 12, 13)) and len(found[0]) == len(found[3]) == 32
        number(found[11])
        if not texts or f"chain/{number(found[8])}.rlp" != name:
            raise Refused("a header is malformed, or filed under another block's number")
        return data

    @staticmethod
    def anchor_of_form(claim):
        """Which block, after which block, which keys, and how."""
        how = claim["anchor"]
        batch = {"mode", "account", "root", "index", "count", "path"}
        numbers = [claim["block"], claim["shown_at"], claim["keys"], *([how["index"], how["count"]] if how["mode"] == "batch" else [])]
        if set(claim) != {"format", "block", "shown_at", "keys", "anchor"} or claim["format"] != "authros-anchor/1":
            raise Refused("an anchor is not of its form")
        if how["mode"] not in ("each", "batch") or set(how) != (batch if how["mode"] == "batch" else {"mode"}):
            raise Refused("an anchor is not of its form")
        if any(type(number) is not int or not 0 <= number < 2 ** 64 for number in numbers) or len(how.get("path", [])) > 14:
            raise Refused("an anchor is not of its form")

    def once(self, what, find):
        """What many records ask for is found out once."""
        if what not in self.known:
            self.known[what] = find()
        return self.known[what]

    def identity(self, hash_, owner, domain):
        """P_C of an identity that proves itself for this account."""
        return self.once(("identity", hash_, owner), lambda: self.proven_identity(hash_, owner, domain))

    def proven_identity(self, hash_, owner, domain):
        data = self.identities.get(hash_)
        if data is None or len(data) != 224:
            return None
        token, signing, envelope, proof = fields(data, 32, 64, 64, 64)
        message = b"AuthROS/identity/1" + domain + owner + signing + envelope + token
        return signing if signing != envelope and sm2_verify(signing, message, der(proof)) else None


def der(raw):
    number = lambda b: bytes([2, len(b)]) + b
    short = lambda b: (lambda s: b"\0" + s if not s or s[0] & 0x80 else s)(b.lstrip(b"\0"))
    body = number(short(raw[:32])) + number(short(raw[32:]))
    return bytes([0x30, len(body)]) + body


class Committed:
    """The extra data of QBFT and IBFT 2.0: vanity, validators, vote, round, seals."""

    def __init__(self, header, extra, is_ibft):
        self.header, self.extra, self.is_ibft = header, extra, is_ibft
        self.named, self.sealed = extra[1], extra[4]

    @classmethod
    def of(cls, header):
        if header[13] != b"ctical byzantine fault tolerance":
            return None
        try:
            extra = rlp(header[12])
        except (Refused, IndexError):
            return None
        lists = isinstance(extra, list) and len(extra) == 5 and isinstance(extra[1], list) and isinstance(extra[4], list)
        if not lists or not isinstance(extra[3], bytes) or isinstance(extra[0], list) or len(extra[0]) != 32:
            return None
        if any(len(one) != 20 or isinstance(one, list) for one in extra[1]) or any(len(one) != 65 or isinstance(one, list) for one in extra[4]):
            return None
        if len(extra[3]) == 4 and extra[3][0] == 0 and extra[2] != []:
            return cls(header, extra, True)
        if len(extra[3]) <= 3 and extra[3][:1] != b"\0" and isinstance(extra[2], list):
            return cls(header, extra, False)
        return None

    def signed(self):
        unsealed = self.extra[:4] + ([] if self.is_ibft else [[]])
        return keccak(encode(self.header[:12] + [encode(unsealed)] + self.header[13:]))

    def seals(self, pinned):
        """The pinned who sealed the header, and the first who did; refused if two thirds of those it names did not."""
        hash_, all_ = self.signed(), []
        for seal in self.sealed:
            sealer = recover(hash_, seal)
            if sealer is None or (self.named and sealer not in self.named):
                raise Refused("a seal in the header is of another round, or of no validator that it names")
            if sealer in all_:
                raise Refused("one has sealed the header twice")
            all_.append(sealer)
        if len(all_) < -(-2 * len(self.named) // 3):
            raise Refused("too few of the validators that the header names have sealed it")
        return {one for one in all_ if one in pinned}, all_[0] if all_ else None


class Record:
    def __init__(self, bundle, trust, digest):
        self.bundle, self.trust, self.digest = bundle, trust, bytes.fromhex(digest)
        self.member = lambda name: bundle.members.get(f"records/{digest}/{name}")
        chain = trust["chain"] if trust else bundle.manifest["chain"]
        self.contract = unhex(chain["contract"])
        self.domain = sm3(b"AuthROS/domain/1" + struct.pack(">Q", chain["id"]) + unhex(chain["genesis"]) + self.contract)

    def bytes(self):  # (a)
        self.record = self.member("record.bin")
        if self.record is None or sm3(self.record) != self.digest:
            raise Refused("it is not the record it is filed as")
        self.header, self.length = parse_header(self.record)
        sizes = sum(int.from_bytes(self.header[name], "big") for name in ("head_length", "body_length"))
        if len(self.record) != self.length + sizes or self.header["domain"] != self.domain:
            raise Refused("its length, or the chain it is bound to, differs")
        persons = self.trust.get("person", []) if self.trust else []
        owner = self.header["owner"]
        self.pinned = [unhex(p["key"]).hex() for p in persons if unhex(p["account"]) == owner and "key" in p]
        self.owner_key = None
        key = self.bundle.keys.get(self.header["signer"].hex())
        signed = b"AuthROS/signature/1" + self.domain + self.digest
        if key is None or not sm2_verify(key, signed, self.member("signature.der") or b""):
            raise Refused("its signature is invalid")
        return "proven"

    def anchor(self):  # (c)
        if self.member("anchor.json") is None:
            raise Unproven("it was not on a chain")
        claim = json.loads(self.member("anchor.json"))
        how, owner = claim["anchor"], self.header["owner"]
        if how["mode"] == "batch":
            path = [unhex(step) for step in how["path"]]
            if not how["index"] < how["count"] or root_of(self.leaf(), how["index"], how["count"], path) != unhex(how["root"]):
                raise Refused("its path does not lead to the root")
        if claim["shown_at"] not in self.bundle.headers:
            raise Unproven("the header is not in the bundle")
        raw = self.bundle.headers[claim["shown_at"]]
        header = rlp(raw)
        number, time = int.from_bytes(header[8], "big"), int.from_bytes(header[11], "big")
        self.storage = self.bundle.once(("storage", number), lambda: Storage(self.bundle.nodes, header[3], self.contract))
        if self.trust and self.storage.code != unhex(self.trust["chain"]["code_hash"]):
            raise Refused("the contract's code is another")
        if how["mode"] == "batch":
            self.account, slot = unhex(how["account"]), mapped(unhex(how["root"]), mapped(unhex(how["account"]), 8))
            block, count, self.time, self.keys = self.storage.numbers(slot)
        else:
            self.account, self.keys = owner, None
            block, count = self.storage.numbers(mapped(self.digest, mapped(owner, 5)))[0], None
            self.time = time if block == number else 0
        if not block:
            raise Refused("the state does not have its anchor")
        if count == how.get("count") == 1 and block < claim["block"]:
            raise Unproven("the state keeps only the first block of a root")
        if block != claim["block"] or count != how.get("count") or number != claim["shown_at"] or block > number:
            raise Refused("the state has another anchor")
        if self.time > time:
            raise Refused("the anchor is later than the state")
        self.block, self.shown_at, self.claimed = block, number, claim["keys"]
        if not self.trust:
            raise Unproven("no signers are pinned")
        chain, pinned = self.trust["chain"], {unhex(one) for one in self.trust["chain"]["signers"]}
        committed = Committed.of(header) if number else None
        if committed:
            found, first = self.bundle.once(("seals", number), lambda: committed.seals(pinned))
            usual = max(1, -(-2 * len(pinned) // 3))
        else:
            found, first = self.bundle.once(("seals", number), lambda: self.seals(number, pinned))
            usual = len(pinned) // 2 + 1
        if len(found) < chain.get("quorum", usual):
            if not pinned:
                raise Unproven("the trust file pins no signers")
            if not found and first is not None:
                raise Refused("sealed by " + first.hex() + ", who is not a pinned signer")
            raise Unproven("sealed by too few of the pinned signers")
        own = header[12].startswith(b"AuthROS chain file version ")
        return "own_chain" if own or chain["sealed_by_exporter"] else "proven"

    def seals(self, number, pinned):
        """The pinned who sealed a block or built on it, until all are met, and who sealed the block itself."""
        found, parent, first = set(), None, None
        for at in range(number, number + 4 * len(pinned) + 16):
            raw = self.bundle.headers.get(at)
            fields_ = rlp(raw) if raw else None
            if raw is None or (parent and fields_[0] != parent):
                break
            sealer = None
            # Another consensus has a different mix hash, or no whole addresses between vanity and seal.
            if len(fields_[12]) >= 97 and (len(fields_[12]) - 97) % 20 == 0 and fields_[13] == bytes(32):
                bare = fields_[:12] + [fields_[12][:-65]] + fields_[13:]
                sealer = recover(keccak(encode(bare)), fields_[12][-65:])
            first = sealer if at == number else first
            if sealer not in pinned:
                break
            found.add(sealer)
            if len(found) == len(pinned):
                break
            parent = keccak(raw)
        return found, first

    def key(self):  # (b)
        if not hasattr(self, "block"):
            raise Unproven("no anchor is shown")
        owner, storage = self.header["owner"], self.storage
        version = self.keys if self.keys is not None and self.account == owner else self.claimed
        keys = storage.keys(owner, version)
        if keys is None:
            raise Unproven("nothing shows the owner's keys")
        after = storage.keys(owner, version + 1)
        if keys[1] > self.block or (after and after[1] <= self.block):
            raise Unproven("that version was not in force")
        signing = self.bundle.identity(keys[0], owner, self.domain)
        if signing is None or (self.pinned and unhex(self.pinned[0]) != sm3(b"\4" + signing)):
            raise Unproven("the identity is not in the bundle, or not the pinned identity")
        self.owner_key = signing
        if sm3(b"\4" + signing) != self.header["signer"]:
            loan = storage.word(mapped(self.header["signer"], mapped(owner, 9)))
            recalled, lent, until = struct.unpack(">3Q", loan[7:31])
            if lent > self.block and self.shown_at > self.block:
                raise Unproven("authorised again later; what applied at the block is not shown")
            if not lent or lent > self.block or 0 < recalled <= self.block or (until and self.time >= until):
                raise Refused("the key was neither the owner's nor an authorised device's")
            if until and not self.time:
                raise Unproven("the device's authorisation had an end, but the block's time is not shown")
        suspended = storage.word(mapped(owner, 10))[7] != 0
        if self.account == owner and self.block != self.shown_at and not suspended:
            return "proven"  # for the moment of anchoring: the contract lets no suspended account anchor
        if self.block != self.shown_at:
            raise Unproven("nothing shows whether the owner was suspended")
        if suspended:
            raise Refused("the owner was suspended")
        return "proven"

    def opened(self):  # (e)
        secret = self.bundle.secrets.get(self.digest)
        if secret is None:
            return "absent"
        message, signature = b"AuthROS/reveal/2" + self.domain + self.bundle.members["disclosed.bin"], self.bundle.members["disclosed.der"]
        checked = lambda key: self.bundle.once(("disclosed", key), lambda: sm2_verify(key, message, signature))
        signed = lambda key: key is not None and checked(key)
        by_owner = signed(self.owner_key) or any(signed(self.bundle.keys.get(key)) for key in self.pinned)
        # Anybody can make an identity for somebody else's account: only the state or a pin says whose a key is.
        tried, all_ = sorted(self.bundle.identities)[:16], len(self.bundle.identities) <= 16
        claims = lambda: any(signed(self.bundle.identity(hash_, self.header["owner"], self.domain)) for hash_ in tried)
        if not by_owner and all_ and not claims():
            raise Refused("the disclosure is not signed by its owner")
        info = b"AuthROS/record/1" + b"".join(self.header[n] for n in ("domain", "owner", "recorder", "epoch", "seq"))
        body_key, body_nonce, head_key, head_nonce, commit = fields(expand(secret, info, 88), 16, 12, 16, 12, 32)
        if commit != self.header["commit"]:
            raise Refused("the secret does not belong to the record")
        aad, sealed = self.record[:self.length], self.record[self.length:]
        split = int.from_bytes(self.header["head_length"], "big")
        self.head = parse_head(gcm_open(head_key, head_nonce, aad, sealed[:split]))
        body, length = gcm_open(body_key, body_nonce, aad, sealed[split:]), self.head["plain_length"]
        how = self.head["compression"]
        if how > 2 or (len(body) != length if how == 0 else not len(body) < length <= LARGEST_MESSAGE):
            raise Refused("the message has another length")
        if length > self.bundle.plain_left:
            raise Unproven("its message is not opened: too much is disclosed in a single file")
        self.bundle.plain_left -= length
        self.body = lz4(body, length) if how == 1 else body
        if not by_owner:
            raise Unproven("it opens; there is no proof that its owner disclosed it")
        return "proven"

    def leaf(self):
        return sm3(b"\0" + b"".join(self.header[n] for n in ("owner", "signer", "recorder", "topic_id", "seq")) + self.digest)

    def existed(self):  # (d), except for the tokens
        anchor = json.loads(self.member("anchor.json") or b"{}").get("anchor", {})
        places = self.bundle.stamped.get(unhex(anchor["root"]), []) if anchor.get("mode") == "batch" else []
        if not places:
            return "absent"
        path = [unhex(one) for one in anchor["path"]]
        if not anchor["index"] < anchor["count"] or root_of(self.leaf(), anchor["index"], anchor["count"], path) != unhex(anchor["root"]):
            raise Refused("its path does not lead to the stamped root")
        if not all(leads for _, leads in places):
            raise Refused("the path of its batch's root does not lead to what was stamped")
        raise Unproven("its batch is under " + " and ".join(sorted(imprint for imprint, _ in places))
                       + "; whether an authority stamped that is checked by openssl, see VERIFY.txt")

    def report(self):
        found, notes = {"digest": self.digest.hex()}, {}
        for name in ("bytes", "anchor", "key", "opened", "time"):
            if name != "bytes" and found["bytes"] != "proven":
                found[name] = "absent" if name == "opened" else "unproven"
                continue
            try:
                found[name] = getattr(self, "existed" if name == "time" else name)()
            except Unproven as why:
                found[name], notes[name] = "unproven", str(why)
            except Refused as why:
                found[name], notes[name] = "refused", str(why)
            except Exception as why:  # a stranger's file: whatever it breaks, it is no evidence
                found[name], notes[name] = "refused", f"malformed: {type(why).__name__}"
        # A state is worth as much as the seals on it.
        for name in ("key", "opened"):
            if found[name] == "proven":
                found[name] = found["anchor"] if found["anchor"] in ("proven", "own_chain") else "unproven"
        if hasattr(self, "body") and found["opened"] != "refused":
            found.update(topic=self.head["topic"], type=self.head["type"], length=len(self.body))
            found["message_sm3"], found["packed"] = sm3(self.body).hex(), self.head["compression"] == 2
        return found | {"notes": notes}


LARGEST_TRUST = 65_536


def der_elements(data):
    """Tags, contents and whole texts of DER's elements one after the other: definite and shortest lengths only."""
    found = []
    while data:
        first, begin = data[1], 2
        size = first
        if first > 0x83 or first == 0x80 or data[0] & 0x1F == 0x1F:
            raise ValueError("a certificate is no DER")
        if first > 0x80:
            begin += first - 0x80
            size = int.from_bytes(data[2:begin], "big")
            if data[2] == 0 or size < 0x80:
                raise ValueError("a certificate is no DER")
        if begin + size > len(data):
            raise ValueError("a certificate ends too early")
        found.append((data[0], data[begin:begin + size], data[:begin + size]))
        data = data[begin + size:]
    return found


def certificate(text):
    """Whether the first PEM in a text is a certificate in form; what it is worth is left to openssl, see VERIFY.txt."""
    begin, end = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
    if begin not in text or end not in text.split(begin, 1)[1]:
        raise ValueError("an authority's certificate is no PEM")
    body = re.sub("[ \t\n\f\r]", "", text.split(begin, 1)[1].split(end, 1)[0])
    try:
        data = base64.b64decode(body, validate=True)
        if base64.b64encode(data).decode() != body:
            raise ValueError("its PEM is broken")
        ((tag, inside, _),) = der_elements(data)
        (signed, algorithm, signature), inner = der_elements(inside), []
        inner = der_elements(signed[1])
        inner = inner[1:] if inner[0][0] == 0xA0 else inner
        serial, again, issuer, validity, subject, key, *rest = inner
        dates, info = der_elements(validity[1]), der_elements(key[1])
        tags = [tag, signed[0], algorithm[0], signature[0], serial[0], *(one[0] for one in (again, issuer, validity, subject, key))]
        good = tags == [0x30] * 3 + [3, 2] + [0x30] * 5 and signature[1][:1] == b"\0" and again[2] == algorithm[2]
        good &= [one[0] for one in rest] in ([], [0x81], [0x82], [0x81, 0x82], [0xA3], [0x81, 0xA3], [0x82, 0xA3], [0x81, 0x82, 0xA3])
        time = {0x17: rb"[0-9]{12}Z", 0x18: rb"[0-9]{14}(\.[0-9]{0,8}[1-9])?Z"}
        good &= len(dates) == 2 and all(one[0] in time and re.fullmatch(time[one[0]], one[1]) for one in dates)
        good &= [one[0] for one in info] == [0x30, 3] and info[1][1][:1] == b"\0"
    except (ValueError, IndexError) as why:
        raise ValueError(f"an authority's certificate is malformed: {why}") from None
    if not good:
        raise ValueError("an authority's certificate is malformed")


def read_trust(path):
    """The reader's own pins; what cannot be meant is refused."""
    text = pathlib.Path(path).read_bytes()
    if len(text) > LARGEST_TRUST:
        raise ValueError("it is longer than any trust file")
    trust = tomllib.loads(text.decode().removeprefix("\ufeff"))
    chain, persons, authorities = trust["chain"], trust.get("person", []), trust.get("authority", [])
    if not all(isinstance(one, list) for one in (chain["signers"], persons, authorities)) or len(authorities) > 16:
        raise ValueError("signers, people or authorities are no list, or more than 16 authorities")
    if any(set(one) != {"name", "certificate"} or not all(isinstance(word, str) for word in one.values()) for one in authorities):
        raise ValueError("an authority has a name and a certificate")
    for one in authorities:
        certificate(one["certificate"])
    signers = [unhex(one) for one in chain["signers"]]
    required, optional = {"id", "genesis", "contract", "code_hash", "signers", "sealed_by_exporter"}, {"quorum"}
    if not required <= set(chain) <= required | optional or not set(trust) <= {"chain", "person", "authority"}:
        raise ValueError("it has not the lines that docs/evidence.md shows")
    if not isinstance(chain["sealed_by_exporter"], bool) or type(chain["id"]) is not int or not 0 <= chain["id"] < 2 ** 63:
        raise ValueError("sealed_by_exporter is true or false, and id a number")
    if any(len(one) != 20 for one in [*signers, unhex(chain["contract"])]) or len(set(signers)) != len(signers):
        raise ValueError("a signer or the contract is not an account, or a signer is named twice")
    quorum = chain.get("quorum", 1)
    if type(quorum) is not int or ("quorum" in chain and not 1 <= quorum <= len(signers)):
        raise ValueError("its quorum is zero, or more than the number of signers")
    accounts = [*chain["signers"], chain["contract"], *(one["account"] for one in persons)]
    hashes = [chain["genesis"], chain["code_hash"], *(one["key"] for one in persons if "key" in one)]
    if not all(has_form(one, ACCOUNT) for one in accounts) or not all(has_form(one, 32) for one in hashes):
        raise ValueError("an account is 0x and 40 digits with its checksum, and a hash or a key is 64 digits")
    if any(not {"account", "name"} <= set(one) <= {"account", "name", "key"} or not isinstance(one["name"], str) for one in persons):
        raise ValueError("a person has an account and a name, and a key or none")
    if any(len(unhex(one)) != 32 for one in [chain["genesis"], chain["code_hash"], *(p["key"] for p in persons if "key" in p)]):
        raise ValueError("a hash is no 32 bytes")
    if len({unhex(one["account"]) for one in persons}) != len(persons):
        raise ValueError("an account is given to two people")
    return trust


def two_histories(records):
    """Numbers that two records by one key have, which is the owner's for one of them."""
    numbered = {}
    for record, found in records:
        if found["bytes"] == "proven":
            of = tuple(record.header[name] for name in ("owner", "signer", "recorder", "topic_id", "seq"))
            numbered.setdefault(of, []).append(found["key"] in ("proven", "own_chain"))
    return [of for of, ones in numbered.items() if len(ones) > 1 and any(ones)]


def is_statement(found):
    """Whether it opened as what a recorder states of itself; bundles add these to what was chosen."""
    return found.get("topic") == "authros/recorder" and found["type"] in ("authros/Birth", "authros/Heads")


def completeness(bundle, records, twice):
    """(f): what of a topic's numbers is there, and up to which number the recorder's own head says that there were any."""
    believed = lambda found: found["key"] in ("proven", "own_chain")
    heads, topics, result = {}, {}, []
    for record, found in records:
        if found["bytes"] != "proven":
            continue
        of = tuple(record.header[name] for name in ("owner", "signer", "recorder", "topic_id"))
        topics.setdefault(of, []).append((int.from_bytes(record.header["seq"], "big"), found))
        opened = believed(found) and found["opened"] != "refused" and hasattr(record, "body")
        if opened and (record.head["topic"], record.head["type"]) == ("authros/recorder", "authros/Heads"):
            if len(record.body) == 115 and record.body[:15] == b"AuthROS/heads/1":
                heads[record.digest] = of[:3], record.header["seq"], record.body, found
    for (owner, signer, recorder, topic), ones in sorted(topics.items()):
        numbers, claims = sorted({seq for seq, found in ones if believed(found)}), []
        for digest, of_topic, number, index, path in bundle.heights:
            if of_topic == topic and digest in heads and heads[digest][0] == (owner, signer, recorder):
                _, seq, body, found = heads[digest]
                count, leaf = int.from_bytes(body[15:19], "big"), sm3(b"\0AuthROS/height/1" + topic + struct.pack(">Q", number))
                leads = index < count and root_of(leaf, index, count, path) == body[19:51]
                claims.append((seq, number if leads else -1, found))
        claims.sort(key=lambda claim: claim[0])
        named = [number for _, number, _ in claims]
        lies = -1 in named or any(after < before for before, after in zip(named, named[1:]))
        own = any(found["key"] == "own_chain" for found in [found for _, found in ones] + [claim[2] for claim in claims[-1:]])
        first, last = (numbers[0], numbers[-1]) if numbers else (None, None)
        missing = last - first + 1 - len(numbers) + max(0, (named[-1] if named else 0) - last) if numbers else 0
        refused = lies or any(one[:4] == (owner, signer, recorder, topic) for one in twice)
        standing = "refused" if refused else "unproven" if not numbers else "own_chain" if own else "proven"
        counted = [found for _, found in ones if believed(found)]
        own_statements = bool(counted) and all(is_statement(found) for found in counted)
        # The recorder of a ring numbers what was mostly not asked for, or fell out: no number of it is missing.
        nothing_claimed = own_statements or recorder[0] == 2
        to = named[-1] if named and not nothing_claimed else None
        if to is not None and not (numbers and first <= to == first - 1 + sum(one <= to for one in numbers)):
            to = None
        missing = 0 if nothing_claimed else missing
        result.append({"owner": "0x" + owner.hex(), "signer": signer.hex(), "recorder": recorder.hex(), "topic_id": topic.hex(), "standing": standing,
                       "first": first, "last": last, "missing": missing,
                       "complete_to": to})
    return result


def exporter(bundle, trust, records):
    """Whether the exporter owns the bundle's records, or is pinned."""
    account, key = unhex(bundle.manifest["exporter"]["account"]), unhex(bundle.manifest["exporter"]["key"])
    pinned = [unhex(one["key"]) for one in (trust or {}).get("person", []) if unhex(one["account"]) == account and "key" in one]
    if pinned:
        return "proven" if pinned == [key] else "unproven"
    whole = [(record, found) for record, found in records if found["bytes"] == "proven"]
    own = lambda record: record.header["owner"] == account
    tied = {found["anchor"] for record, found in whole if own(record) and record.owner_key and sm3(b"\4" + record.owner_key) == key}
    if not all(own(record) for record, _ in whole):
        return "unproven"
    return "proven" if "proven" in tied else "own_chain" if "own_chain" in tied else "unproven"


def recorded_file(body):
    """What a follower states of a recorded file: length, digest, and its chunks; None if it is no such statement."""
    at = 0

    def text():
        nonlocal at
        length = struct.unpack_from("<I", body, at)[0]
        at += 4 + length
        if at > len(body):
            raise ValueError("a text is longer than the statement")
        return body[at - length:at].decode()

    try:
        if text() != "authros.recording":
            return None
        at += 4
        if struct.unpack_from("<I", body, at - 4)[0] != len(body) - at:
            return None
        own, chunks, after = [], [], 0
        while at < len(body):
            name, value = text(), text()
            if not name.startswith("chunk "):
                own.append((name, value))
                continue
            length, digest = value.split(" ")
            chunks.append((int(name[6:]), int(length), bytes.fromhex(digest)))
            begins, after = after, sum(chunks[-1][:2])
            if chunks[-1][0] < begins or after >= 1 << 64 or len(chunks) > 1 << 19:
                return None
        found = dict(own)
        name, length, digest, closed = found["name"], int(found["length"]), bytes.fromhex(found["sm3"]), found["closed"]
        # There is one way to write it.
        spelled = [("name", name), ("length", str(length)), ("sm3", digest.hex()), ("closed", closed)]
        spelled += [(f"chunk {begins}", f"{size} {sm3.hex()}") for begins, size, sm3 in chunks]
        spelled = b"".join(struct.pack("<I", len(one.encode())) + one.encode() for pair in spelled for one in pair)
        if body[25:] != spelled or closed not in ("yes", "no") or length >= 1 << 64 or any(len(one) != 32 for one in [digest, *(one[2] for one in chunks)]):
            return None
        return {"name": name, "length": length, "sm3": digest, "chunks": chunks}
    except (ValueError, KeyError, struct.error):
        return None


def running_sm3():
    """A running hash: OpenSSL's where Python has it, for recordings are large; else the one above, of all bytes at once."""
    class Gathered(bytearray):
        update = bytearray.extend
        digest = sm3
    return hashlib.new("sm3") if "sm3" in hashlib.algorithms_available else Gathered()


def compare(stated, path):
    """Where a file differs from what is stated of it."""
    whole, differing, length = running_sm3(), [], 0
    with open(path, "rb") as file:
        def feed(left, hashes):
            done = 0
            while left is None or done < left:
                block = file.read(1 << 18 if left is None else min(left - done, 1 << 18))
                if not block:
                    break
                done += len(block)
                for one in hashes:
                    one.update(block)
            return done

        for at, size, digest in stated["chunks"]:
            length += feed(max(0, at - length), [whole])
            own = running_sm3()
            read = feed(size, [whole, own])
            length += read
            if read != size or own.digest() != digest:
                differing.append(at)
        length += feed(None, [whole])
    return length == stated["length"] and whole.digest() == stated["sm3"], length, differing


def recording(path, records):
    """How a recorded file compares with the statements that are opened in the bundle."""
    worst = None
    for record, found in records:
        opened = found["opened"] in ("proven", "own_chain", "unproven") and found["bytes"] == "proven" and hasattr(record, "body")
        is_named = opened and (record.head["topic"], record.head["type"]) == ("authros/attachments", "authros/Metadata")
        stated = recorded_file(record.body) if is_named and record.head["tags"].get("recorded") == "file" else None
        if stated:
            whole, length, differing = compare(stated, path)
            one = {"standing": "proven" if whole else "refused", "record": record.digest.hex(), "name": stated["name"],
                   "bytes": length, "chunks": len(stated["chunks"]), "differing": differing[:100]}
            if whole:
                return one
            worst = worst or one
    return worst or {"standing": "absent", "record": None, "name": None, "bytes": pathlib.Path(path).stat().st_size, "chunks": 0, "differing": []}


# SHA-256 of the text that bundles have as VERIFY.txt.
READ_ME = "570b9409b1a4430dca178c9ae8d7d9353dfa37f524c915a4bf90dc04c6ab4ddf"


def notes(bundle, tied):
    """What has to be known besides the levels."""
    found = []
    if tied == "unproven":
        found.append("nothing shows who put the bundle together: a stranger may have left records out")
    if "report.html" in bundle.members:
        found.append("report.html was not checked: it says what its author wanted")
    if "VERIFY.txt" in bundle.members and hashlib.sha256(bundle.members["VERIFY.txt"]).hexdigest() != READ_ME:
        found.append("VERIFY.txt is not the text that belongs there: do nothing of what it says")
    return found


def main(arguments):
    trust = recorded = None
    try:
        if "--recording" in arguments:
            at = arguments.index("--recording")
            recorded = arguments[at + 1]
            arguments = arguments[:at] + arguments[at + 2:]
            if not pathlib.Path(recorded).is_file():
                raise OSError(recorded + " is not a file")
        if "--trust" in arguments:
            at = arguments.index("--trust")
            trust = read_trust(arguments[at + 1])
            arguments = arguments[:at] + arguments[at + 2:]
        if not pathlib.Path(arguments[0]).is_file():
            raise OSError(arguments[0] + " is not a file")
    except IndexError:
        print("usage: verify.py NAME.authros [--trust trust.toml] [--recording FILE]", file=sys.stderr)
        return 2
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as why:
        print(f"verify.py: {why}", file=sys.stderr)
        return 3
    try:
        bundle = Bundle(arguments[0])
        digests = sorted({name.split("/")[1] for name in bundle.members if name.startswith("records/")})
        all_ = [Record(bundle, trust, digest) for digest in digests]
        records = [record.report() for record in all_]
        twice = two_histories(zip(all_, records))
        complete = completeness(bundle, list(zip(all_, records)), twice)
        tied = exporter(bundle, trust, list(zip(all_, records)))
    except Exception as why:  # a stranger's file: whatever it breaks, it is no evidence
        print(json.dumps({"outcome": "refused", "why": str(why) if isinstance(why, Refused) else f"a member is not of its form ({type(why).__name__})"}))
        return 6
    standings = [(name, record[name]) for record in records for name in ("bytes", "key", "anchor", "opened", "time")]
    needed = [[record[name] for name in ("bytes", "key", "anchor")] for record in records]
    # A statement of which something is merely not proven says nothing, and spoils nothing.
    spoken = [of for record, of in zip(records, needed) if not (is_statement(record) and "unproven" in of)]
    good = all(standing == "proven" for of in spoken or needed for standing in of)
    refused = any(one["standing"] == "refused" for one in complete) or any(standing == "refused" for _, standing in standings)
    outcome = "refused" if refused else "holds" if trust and records and good and tied == "proven" else "incomplete"
    told = {"outcome": outcome, "exporter": tied, "notes": notes(bundle, tied), "records": records, "complete": complete}
    compared = "proven"
    if recorded:
        told["recording"] = recording(recorded, list(zip(all_, records)))
        compared = told["recording"]["standing"]
    print(json.dumps(told, indent=1))
    if "refused" in (outcome, compared):
        return 6
    return 8 if "incomplete" == outcome or compared == "absent" else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
