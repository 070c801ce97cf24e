"""The archive in its one form, and JSON in its one spelling."""
import functools
import json
import re
import struct
import zlib

from .errors import Malformed
from .hashes import keccak

LARGEST_ARCHIVE = 256 * 2 ** 20
MOST_MEMBERS = 60_000


def unpacked(data):
    """The members: what is read is written again and compared, so that nothing hides between them."""
    members, at = {}, 0
    while data[at:at + 4] == b"PK\3\4":
        size, _, named, extra = struct.unpack("<IIHH", data[at + 18:at + 30])
        name, begin = data[at + 30:at + 30 + named].decode("ascii"), at + 30 + named
        at = begin + size
        if at > len(data) or extra or name in members or len(members) == MOST_MEMBERS:
            raise Malformed("the archive is not of the one form")
        members[name] = data[begin:at]
    if not members or packed(members) != data:
        raise Malformed("the archive is not of the one form")
    return members


def packed(members):
    parts, central, at = [], [], 0
    for name in [name for name in ("mimetype",) if name in members] + sorted(set(members) - {"mimetype"}):
        content = members[name]
        same = struct.pack("<5H3I2H", 10, 0, 0, 0, 0x21, zlib.crc32(content), len(content), len(content), len(name), 0)
        central += [b"PK\1\2" + struct.pack("<H", 10), same, bytes(10), struct.pack("<I", at), name.encode()]
        parts += [b"PK\3\4", same, name.encode(), content]
        at += 30 + len(name) + len(content)
    listed = b"".join(central)
    end = struct.pack("<4H2IH", 0, 0, len(members), len(members), len(listed), at, 0)
    return b"".join(parts) + listed + b"PK\5\6" + end


def json_of(data, form, name):
    """JSON of this form: UTF-8, each line of an object once, whole numbers only. Python alone would also take others."""
    def distinct(pairs):
        if len({name for name, _ in pairs}) != len(pairs):
            raise Malformed("a line is twice in JSON")
        return dict(pairs)

    def other(text):
        raise Malformed(text[:40] + " in JSON is no whole number")

    whole = lambda text: other(text) if text.startswith("-") or len(text) > 20 else int(text)
    found = json.loads(data.decode(), object_pairs_hook=distinct, parse_int=whole, parse_float=other, parse_constant=other)
    if not has_form(found, form):
        raise Malformed(name + " is not of its form")
    return found


def format_of(data):
    """The format that JSON names, whatever else it has; or None."""
    try:
        return json.loads(data.decode()).get("format")
    except (ValueError, AttributeError, RecursionError):
        return None


ACCOUNT = 20


@functools.lru_cache(maxsize=4096)
def checksummed(small):
    """An account's 40 digits in the spelling of EIP-55."""
    return "".join(one.upper() if int(by, 16) >= 8 else one for one, by in zip(small, keccak(small.encode()).hex()))


def is_account(text):
    """0x and 40 digits; capital letters among small ones are its checksum."""
    if not re.fullmatch("0x[0-9a-fA-F]{40}", text):
        return False
    digits, small = text[2:], text[2:].lower()
    return digits in (small, small.upper(), checksummed(small))


def has_form(found, form):
    """A number in a form stands for hex of that many bytes, a tuple for one form or another."""
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


def unhex(text):
    return bytes.fromhex(text[2:] if text.startswith("0x") else text)
