"""Certificates (X.509, RFC 5280) as far as time stamp authorities need them, and their signatures: RSA and ECDSA."""
import base64
import hashlib
import re

from .curves import P256, P384, ecdsa_verify, point_of
from .der import BITS, BOOLEAN, NULL, OCTETS, SEQUENCE, SET, Der, context, primitive, seconds
from .errors import Unchecked


def oid(text):
    """An object identifier's content."""
    first, second, *rest = (int(part) for part in text.split("."))
    out = bytearray([40 * first + second])
    for number in rest:
        digits = [number & 0x7F]
        while number > 0x7F:
            number >>= 7
            digits.append(number & 0x7F | 0x80)
        out += bytes(reversed(digits))
    return bytes(out)


HASHES = {oid("2.16.840.1.101.3.4.2.1"): "sha256", oid("2.16.840.1.101.3.4.2.2"): "sha384", oid("2.16.840.1.101.3.4.2.3"): "sha512"}
RSA, RSA_PSS, MASK = oid("1.2.840.113549.1.1.1"), oid("1.2.840.113549.1.1.10"), oid("1.2.840.113549.1.1.8")
CURVE_KEY = oid("1.2.840.10045.2.1")
CURVES = {oid("1.2.840.10045.3.1.7"): P256, oid("1.3.132.0.34"): P384}
SCHEMES = {
    RSA: ("pkcs1", None), oid("1.2.840.113549.1.1.11"): ("pkcs1", "sha256"), oid("1.2.840.113549.1.1.12"): ("pkcs1", "sha384"),
    oid("1.2.840.113549.1.1.13"): ("pkcs1", "sha512"), oid("1.2.840.10045.4.3.2"): ("ecdsa", "sha256"),
    oid("1.2.840.10045.4.3.3"): ("ecdsa", "sha384"), oid("1.2.840.10045.4.3.4"): ("ecdsa", "sha512"),
}
KEY_USAGE, BASIC_CONSTRAINTS, POLICIES = oid("2.5.29.15"), oid("2.5.29.19"), oid("2.5.29.32")
EXTENDED_KEY_USAGE, TIME_STAMPING = oid("2.5.29.37"), oid("1.3.6.1.5.5.7.3.8")
COMMON_NAME = oid("2.5.4.3")


class Unknown(ValueError):
    """Of an algorithm that no verifier of AuthROS checks: refused where it matters."""


def digest_of(name, data):
    try:
        return hashlib.new(name, data, usedforsecurity=False).digest()
    except ValueError:
        raise Unchecked(f"this Python has no {name}") from None


def nothing(der):
    null = der.optional(NULL)
    if null is not None and null.content:
        raise ValueError("NULL is not empty")
    der.end()


def hash_name(der):
    """From an AlgorithmIdentifier: nothing or NULL after the name."""
    inner = der.inside(SEQUENCE)
    name = HASHES.get(inner.object())
    if name is None:
        raise Unknown("a hash other than SHA-256, -384 or -512")
    nothing(inner)
    return name


def scheme(der):
    inner = der.inside(SEQUENCE)
    name = inner.object()
    if name == RSA_PSS:
        return pss(inner)
    nothing(inner)
    if name not in SCHEMES:
        raise Unknown("an algorithm other than RSA or ECDSA with SHA-256, -384 or -512")
    return SCHEMES[name]


def pss(der):
    """RFC 4055, 3.1: the same hash twice, and a salt of the same length. Without its parts the hash is SHA-1."""
    inner = der.inside(SEQUENCE)
    der.end()
    parts = [inner.inside_optional(context(number)) for number in range(3)]
    trailer = inner.inside_optional(context(3))
    if None in parts:
        raise Unknown("RSA-PSS with parameters other than a single hash and a salt of its length")
    name = hash_name(parts[0])
    generator = parts[1].inside(SEQUENCE)
    is_known = generator.object() == MASK
    same = hash_name(generator) == name
    salt = parts[2].small()
    is_one = trailer is None or trailer.small() == 1
    for one in (*parts, generator, inner, *([trailer] if trailer else [])):
        one.end()
    if not (is_known and same and is_one and salt == hashlib.new(name).digest_size):
        raise Unknown("RSA-PSS with parameters other than a single hash and a salt of its length")
    return "pss", name


class Key:
    def __init__(self, der):
        info = der.inside(SEQUENCE)
        algorithm = info.inside(SEQUENCE)
        self.name = algorithm.object()
        self.curve = CURVES.get(algorithm.any().content) if self.name == CURVE_KEY else None
        self.bytes = info.bits()
        info.end()

    def verifies(self, how, message, signature):
        """Whether the signature is right; Unknown where nobody of us checks that."""
        kind, name = how
        if name is None:
            raise ValueError("no hash is named")
        if kind == "ecdsa" and name == "sha512":
            raise Unknown("ECDSA with SHA-512")
        if self.name not in (RSA, RSA_PSS) and self.curve is None:
            raise Unknown("a key that is neither RSA nor on P-256 or P-384")
        if (kind == "ecdsa") != (self.curve is not None) or (kind == "pkcs1" and self.name == RSA_PSS):
            raise ValueError("its algorithm does not fit its key")
        digest = digest_of(name, message)
        if self.curve:
            size = (self.curve.p.bit_length() + 7) // 8
            is_point = len(self.bytes) == 2 * size + 1 and self.bytes[0] == 4
            return is_point and ecdsa_verify(self.curve, point_of(self.bytes[1:]), digest, signature)
        return rsa_verify(self.bytes, kind, name, digest, signature)


def positive(der):
    data = der.integer()
    if data[0] & 0x80 or data == b"\0":
        raise ValueError("a number is not positive")
    return int.from_bytes(data, "big")


def rsa_verify(key, kind, name, digest, signature):
    """RFC 8017, 8.1.2 and 8.2.2, with keys of 2048 to 8192 bits."""
    try:
        inner = Der.only(key, SEQUENCE)
        n, e = positive(inner), positive(inner)
        inner.end()
    except ValueError:
        return False
    size = (n.bit_length() + 7) // 8
    if size < 256 or n.bit_length() > 8192 or not n & 1 or not e & 1 or not 3 <= e < 1 << 33:
        return False
    s = int.from_bytes(signature, "big")
    if len(signature) != size or s >= n:
        return False
    encoded = pow(s, e, n).to_bytes(size, "big")
    if kind == "pss":
        return is_pss(encoded, n.bit_length() - 1, name, digest)
    algorithm = next(one for one, known in HASHES.items() if known == name)
    info = put(SEQUENCE, put(SEQUENCE, put(6, algorithm) + put(NULL, b"")) + put(OCTETS, digest))
    return encoded == b"\0\1" + b"\xff" * (size - len(info) - 3) + b"\0" + info


def put(tag, content):
    return bytes([tag, len(content)]) + content


def is_pss(encoded, bits, name, digest):
    size = len(digest)
    length = (bits + 7) // 8
    spare = len(encoded) - length
    encoded, before = encoded[spare:], encoded[:spare]
    masked, hashed, last = encoded[:length - size - 1], encoded[-size - 1:-1], encoded[-1]
    free = 8 * length - bits
    if any(before) or last != 0xBC or masked[0] >> (8 - free):
        return False
    mask = b"".join(digest_of(name, hashed + number.to_bytes(4, "big")) for number in range(-(-len(masked) // size)))
    plain = bytearray(a ^ b for a, b in zip(masked, mask))
    plain[0] &= 0xFF >> free
    zeros = len(plain) - size - 1
    if zeros < 0 or any(plain[:zeros]) or plain[zeros] != 1:
        return False
    return digest_of(name, bytes(8) + digest + bytes(plain[zeros + 1:])) == hashed


class Certificate:
    """Whatever is wrong with its form is a ValueError."""

    def __init__(self, data):
        self.der = data
        outer = Der.only(data, SEQUENCE)
        signed, algorithm = outer.element(SEQUENCE), outer.element(SEQUENCE)
        self.signed, self.signature = signed.whole, outer.bits()
        outer.end()
        try:
            self.scheme = scheme(Der(algorithm.whole))
        except Unknown as why:
            self.scheme = why
        inner = Der(signed.content)
        version = inner.inside_optional(context(0))
        if version is not None:
            version.small()
            version.end()
        self.serial = inner.integer()
        if inner.element(SEQUENCE).whole != algorithm.whole:
            raise ValueError("it names two signature algorithms")
        self.issuer = inner.element(SEQUENCE).whole
        validity = inner.inside(SEQUENCE)
        self.begins, self.ends = seconds(validity.any()), seconds(validity.any())
        validity.end()
        self.subject = inner.element(SEQUENCE).whole
        self.key = Key(inner)
        for unique in (1, 2):
            inner.optional(primitive(unique))
        self.most_below, self.usage, self.stamps, self.is_unknown = None, None, False, False
        extensions = inner.inside_optional(context(3))
        if extensions is not None:
            self.read(extensions)
        inner.end()

    def read(self, der):
        everything, seen = der.inside(SEQUENCE), set()
        der.end()
        while everything.rest:
            one = everything.inside(SEQUENCE)
            name = one.object()
            if name in seen:
                raise ValueError("an extension appears twice")
            seen.add(name)
            is_critical = one.boolean() if one.next_tag() == BOOLEAN else False
            value = one.element(OCTETS).content
            one.end()
            self.take(name, is_critical, value)

    def take(self, name, is_critical, value):
        if name == BASIC_CONSTRAINTS:
            inner = Der.only(value, SEQUENCE)
            issues = inner.next_tag() == BOOLEAN and inner.boolean()
            most = inner.small() if inner.rest else 2 ** 64 - 1
            inner.end()
            self.most_below = most if issues else None
        elif name == KEY_USAGE:
            outer = Der(value)
            self.usage = (outer.element(BITS).content + b"\0\0")[1]
            outer.end()
        elif name == EXTENDED_KEY_USAGE:
            inner = Der.only(value, SEQUENCE)
            self.stamps = inner.object() == TIME_STAMPING and not inner.rest and is_critical
        elif name != POLICIES:
            self.is_unknown |= is_critical

    def may_issue(self):
        return self.most_below is not None and (self.usage is None or self.usage & 0x04 != 0)

    def may_stamp(self):
        return self.stamps and (self.usage is None or self.usage & 0xC0 != 0)

    def is_valid_at(self, at):
        return self.begins <= at <= self.ends

    def is_signed_by(self, above):
        if isinstance(self.scheme, Unknown):
            raise self.scheme
        return above.key.verifies(self.scheme, self.signed, self.signature)

    def name(self):
        """For people: the last common name of its subject, or its serial number."""
        found = None
        try:
            parts = Der.only(self.subject, SEQUENCE)
            while parts.rest:
                some = parts.inside(SET)
                while some.rest:
                    one = some.inside(SEQUENCE)
                    if one.object() == COMMON_NAME:
                        found = one.any().content.decode("utf-8", "replace")
        except ValueError:
            found = None
        return found if found is not None else "serial number " + self.serial[:20].hex()


def from_pem(text):
    """The first certificate of a PEM."""
    begin, end = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
    if begin not in text or end not in text.split(begin, 1)[1]:
        raise ValueError("it is not a PEM certificate")
    body = re.sub("[ \t\n\f\r]", "", text.split(begin, 1)[1].split(end, 1)[0])
    data = base64.b64decode(body, validate=True)
    if base64.b64encode(data).decode() != body:
        raise ValueError("its PEM is broken")
    return Certificate(data)
