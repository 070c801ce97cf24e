"""Signatures on curves over prime fields: SM2 (GB/T 32918), secp256k1 with recovery, and ECDSA on P-256 and P-384."""
import collections
import functools
import struct

from .hashes import keccak, sm3

Curve = collections.namedtuple("Curve", "p a b n g")

P = 0xFFFFFFFEFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFF00000000FFFFFFFFFFFFFFFF
SM2 = Curve(P, P - 3, 0x28E9FA9E9D9F5E344D5A9E4BCF6509A7F39789F515AB8F92DDBCBD414D940E93,
            0xFFFFFFFEFFFFFFFFFFFFFFFFFFFFFFFF7203DF6B21C6052B53BBF40939D54123,
            (0x32C4AE2C1F1981195F9904466A39C9948FE30BBFF2660BE1715A4589334C74C7,
             0xBC3736A2F4F6779C59BDCEE36B692153D0A9877CC62A474002DF32E52139F0A0))
SECP256K1 = Curve(2 ** 256 - 2 ** 32 - 977, 0, 7, 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141,
                  (0x79BE667EF9DCBBAC55A06295CE870B07029BFCDB2DCE28D959F2815B16F81798,
                   0x483ADA7726A3C4655DA4FBFC0E1108A8FD17B448A68554199C47D08FFB10D4B8))
P256 = Curve(0xFFFFFFFF00000001000000000000000000000000FFFFFFFFFFFFFFFFFFFFFFFF,
             0xFFFFFFFF00000001000000000000000000000000FFFFFFFFFFFFFFFFFFFFFFFC,
             0x5AC635D8AA3A93E7B3EBBD55769886BC651D06B0CC53B0F63BCE3C3E27D2604B,
             0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551,
             (0x6B17D1F2E12C4247F8BCE6E563A440F277037D812DEB33A0F4A13945D898C296,
              0x4FE342E2FE1A7F9B8EE7EB4A7C0F9E162BCE33576B315ECECBB6406837BF51F5))
P384 = Curve(2 ** 384 - 2 ** 128 - 2 ** 96 + 2 ** 32 - 1, 2 ** 384 - 2 ** 128 - 2 ** 96 + 2 ** 32 - 4,
             0xB3312FA7E23EE7E4988E056BE3F82D19181D9C6EFE8141120314088F5013875AC656398D8A2ED19D2A85C8EDD3EC2AEF,
             0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFC7634D81F4372DDF581A0DB248B0A77AECEC196ACCC52973,
             (0xAA87CA22BE8B05378EB1C71EF320AD746E1D3B628BA79B9859F741E082542A385502F25DBF55296C3A545E3872760AB7,
              0x3617DE4A96262C6F5D9E98BF9292DC29F8F41DBD289A147CE9DA3113B5F0B8C00A60B1CE1D7E819D7A431D7C90EA0E5F))


def is_on(curve, point):
    x, y = point
    return max(x, y) < curve.p and (y * y - x ** 3 - curve.a * x - curve.b) % curve.p == 0


def double(curve, point):  # Jacobian: x / z^2, y / z^3; z = 0 is the point at infinity
    x, y, z = point
    p = curve.p
    if not y or not z:
        return 0, 1, 0
    yy = y * y % p
    s, zz = 4 * x * yy % p, z * z % p
    m = (3 * x * x + curve.a * zz * zz) % p
    x3 = (m * m - 2 * s) % p
    return x3, (m * (s - x3) - 8 * yy * yy) % p, 2 * y * z % p


def add(curve, one, other):
    if not one[2]:
        return other
    if not other[2]:
        return one
    p = curve.p
    (x1, y1, z1), (x2, y2, z2) = one, other
    zz1, zz2 = z1 * z1 % p, z2 * z2 % p
    u1, u2 = x1 * zz2 % p, x2 * zz1 % p
    s1, s2 = y1 * zz2 * z2 % p, y2 * zz1 * z1 % p
    if u1 == u2:
        return double(curve, one) if s1 == s2 else (0, 1, 0)
    h, r = u2 - u1, s2 - s1
    hh = h * h % p
    hhh, v = h * hh % p, u1 * hh % p
    x3 = (r * r - hhh - 2 * v) % p
    return x3, (r * (v - x3) - s1 * hhh) % p, h * z1 * z2 % p


@functools.lru_cache(maxsize=256)
def digits(curve, point):
    """The multiples of a point by 0 to 15."""
    found = [(0, 1, 0)]
    for _ in range(15):
        found.append(add(curve, found[-1], (*point, 1)))
    return found


def combined(curve, u, v, point):
    """u G + v point, or None if that is the point at infinity."""
    total, of_g, of_point = (0, 1, 0), digits(curve, curve.g), digits(curve, point)
    for place in range((curve.n.bit_length() + 3) // 4 * 4 - 4, -4, -4):
        for _ in range(4):
            total = double(curve, total)
        if u >> place & 15:
            total = add(curve, total, of_g[u >> place & 15])
        if v >> place & 15:
            total = add(curve, total, of_point[v >> place & 15])
    x, y, z = total
    if not z:
        return None
    inverse = pow(z, -1, curve.p)
    return x * inverse * inverse % curve.p, y * inverse ** 3 % curve.p


def point_of(public):
    half = len(public) // 2
    return tuple(int.from_bytes(public[at:at + half], "big") for at in (0, half))


def is_sm2_point(public):
    return len(public) == 64 and is_on(SM2, point_of(public))


def der_numbers(der, size):
    """SEQUENCE of two INTEGERs that are positive or 0 and have at most the given length, in DER's only form."""
    if len(der) < 2 or der[0] != 0x30 or der[1] != len(der) - 2 or der[1] > 0x7F:
        raise ValueError("no signature")
    numbers, rest = [], der[2:]
    for _ in range(2):
        if len(rest) < 3 or rest[0] != 2 or not 0 < rest[1] <= size + 1 or len(rest) < 2 + rest[1]:
            raise ValueError("no signature")
        value, rest = rest[2:2 + rest[1]], rest[2 + rest[1]:]
        is_padded = len(value) > 1 and value[0] == 0
        if value[0] & 0x80 or (is_padded and not value[1] & 0x80) or len(value) > size + is_padded:
            raise ValueError("no signature")
        numbers.append(int.from_bytes(value, "big"))
    if rest:
        raise ValueError("no signature")
    return numbers


def sm2_verify(public, message, der):
    try:
        r, s = der_numbers(der, 32)
    except ValueError:
        return False
    n, t = SM2.n, (r + s) % SM2.n
    if not (is_sm2_point(public) and 0 < r < n and 0 < s < n and t):
        return False
    name = b"1234567812345678"
    constants = b"".join(number.to_bytes(32, "big") for number in (SM2.a, SM2.b, *SM2.g))
    z = sm3(struct.pack(">H", len(name) * 8) + name + constants + public)
    e = int.from_bytes(sm3(z + message), "big")
    found = combined(SM2, s, t, point_of(public))
    return found is not None and (e + found[0]) % n == r


def ecdsa_verify(curve, point, digest, der):
    size = (curve.n.bit_length() + 7) // 8
    try:
        r, s = der_numbers(der, size)
    except ValueError:
        return False
    if not (is_on(curve, point) and 0 < r < curve.n and 0 < s < curve.n):
        return False
    e, w = int.from_bytes(digest[:size], "big"), pow(s, -1, curve.n)
    found = combined(curve, e * w % curve.n, r * w % curve.n, point)
    return found is not None and found[0] % curve.n == r


def recover(hash_, seal):
    """The account whose secp256k1 key made a seal: r, s, parity."""
    p, order = SECP256K1.p, SECP256K1.n
    r, s, parity = int.from_bytes(seal[:32], "big"), int.from_bytes(seal[32:64], "big"), seal[64]
    square = (pow(r, 3, p) + 7) % p
    y = pow(square, (p + 1) // 4, p)
    if parity > 1 or not 0 < r < order or not 0 < s <= order // 2 or y * y % p != square:
        return None
    point, inverse = (r, y if y & 1 == parity else p - y), pow(r, -1, order)
    e = int.from_bytes(hash_, "big")
    key = combined(SECP256K1, -e * inverse % order, s * inverse % order, point)
    return None if key is None else keccak(key[0].to_bytes(32, "big") + key[1].to_bytes(32, "big"))[12:]
