"""RLP, tries (Yellow Paper, appendices B to D), and the contract's storage in the state after a block."""
import struct

from .errors import Malformed, Unproven, Refused
from .hashes import keccak

DEEPEST = 32


def rlp(data):
    """One item, bytes or a list, each length in its one form."""
    def item(at, depth):
        first = data[at]
        if first < 0x80:
            return data[at:at + 1], at + 1
        short, base = (first < 0xB8, 0x80) if first < 0xC0 else (first < 0xF8, 0xC0)
        size, begin = first - base, at + 1
        if not short:
            begin += size - 55
            digits = data[at + 1:begin]
            size = int.from_bytes(digits, "big")
            if digits[:1] == b"\0" or size <= 55:
                raise ValueError("a length of RLP is not in its shortest form")
        end = begin + size
        if end > len(data):
            raise ValueError("RLP ends too early")
        if first < 0xC0:
            if short and size == 1 and data[begin] < 0x80:
                raise ValueError("a byte of RLP is not in its shortest form")
            return data[begin:end], end
        found, at = [], begin
        while at < end:
            if depth == DEEPEST:
                raise ValueError("lists of RLP lie too deep")
            one, at = item(at, depth + 1)
            found.append(one)
        if at != end:
            raise ValueError("RLP ends too early")
        return found, end

    if not data:
        raise ValueError("RLP ends too early")
    found, end = item(0, 0)
    if end != len(data):
        raise ValueError("there is something behind the RLP")
    return found


def encode(item):
    body = item if isinstance(item, bytes) else b"".join(map(encode, item))
    base = 0x80 if isinstance(item, bytes) else 0xC0
    if base == 0x80 and len(body) == 1 and body[0] < 0x80:
        return body
    if len(body) < 56:
        return bytes([base + len(body)]) + body
    size = len(body).to_bytes((len(body).bit_length() + 7) // 8, "big")
    return bytes([base + 55 + len(size)]) + size + body


def number(item):
    """As RLP has it, of at most 64 bits."""
    if not isinstance(item, bytes) or len(item) > 8 or item[:1] == b"\0":
        raise ValueError("a number in RLP is malformed")
    return int.from_bytes(item, "big")


EMPTY = keccak(b"\x80")
LONGEST_NODE = 1024
MOST_NODES = 1_000_000


class NotShown(Exception):
    """A node of the path is not in the bundle."""


class Broken(Exception):
    """A node, an account or a word is none."""


def nodes_of(data):
    """The nodes of the member, by their hashes."""
    nodes = rlp(data)
    if not isinstance(nodes, list) or len(nodes) > MOST_NODES:
        raise Malformed("the nodes of the state are no list, or too many")
    if any(not isinstance(node, bytes) or len(node) > LONGEST_NODE for node in nodes):
        raise Malformed("a node of the state is longer than any node")
    found = {keccak(node): node for node in nodes}
    if list(found) != sorted(found) or len(found) != len(nodes):
        raise Malformed("the nodes of the state are not distinct and in order of their hashes")
    return found


def nibbles(data):
    return [nibble for byte in data for nibble in (byte >> 4, byte & 15)]


def look_up(nodes, root, key):
    """The value of a key below a root, or None if the trie proves that there is none. Keys are hashed."""
    if root == EMPTY:
        return None
    path, at = nibbles(keccak(key)), root
    while True:
        if isinstance(at, bytes):
            if at == b"":
                return None
            if len(at) != 32:
                raise Broken
            if at not in nodes:
                raise NotShown
            at = parsed(nodes[at])
        if not isinstance(at, list) or len(at) not in (2, 17):
            raise Broken
        if len(at) == 17:
            if not path:
                return None
            at, path = at[path[0]], path[1:]
            continue
        if not isinstance(at[0], bytes) or not at[0] or at[0][0] >= 0x40:
            raise Broken
        packed = nibbles(at[0])
        own, is_leaf = packed[2 - (packed[0] & 1):], packed[0] & 2
        if path[:len(own)] != own:
            return None
        path = path[len(own):]
        if is_leaf:
            if not isinstance(at[1], bytes):
                raise Broken
            return None if path else at[1]
        if not own:  # it could form a loop
            raise Broken
        at = at[1]


def parsed(data):
    try:
        return rlp(data)
    except ValueError:
        raise Broken from None


def pad(value):
    return (value.to_bytes(8, "big") if isinstance(value, int) else value).rjust(32, b"\0")


def mapped(key, below):
    return keccak(pad(key) + pad(below))


class Storage:
    """The contract's. What the nodes do not show is not proven, what they contradict is refused, for the reasons given."""

    def __init__(self, nodes, state, contract):
        account = look_up(nodes, state, contract)
        if account is None:
            raise Broken
        fields = parsed(account)
        if not isinstance(fields, list) or len(fields) != 4 or any(not isinstance(one, bytes) or len(one) != 32 for one in fields[2:]):
            raise Broken
        self.root, self.code = fields[2:]
        self.nodes = nodes

    def word(self, slot):
        value = look_up(self.nodes, self.root, slot)
        word = parsed(value) if value is not None else b""
        if not isinstance(word, bytes) or len(word) > 32:
            raise Broken
        return pad(word)

    def numbers(self, slot):
        """Four eight-byte numbers, from the low end."""
        return struct.unpack(">4Q", self.word(slot))[::-1]

    def anchor(self, account, root):
        return self.numbers(mapped(root, mapped(account, 8)))

    def uploaded(self, owner, digest):
        return self.numbers(mapped(digest, mapped(owner, 5)))[0]

    def keys(self, owner, version):
        """The hash of the identity and the block since when; None if there is no such version."""
        if version >= 2 ** 64:
            return None
        slot = mapped(version, mapped(owner, 15))
        identity = self.word(slot)
        if identity == bytes(32):
            return None
        after = ((int.from_bytes(slot, "big") + 1) % 2 ** 256).to_bytes(32, "big")
        return identity, self.numbers(after)[0]

    def loan(self, owner, device):
        """Until when, from which block, and revoked in which block."""
        return struct.unpack(">3Q", self.word(mapped(device, mapped(owner, 9)))[7:31])[::-1]

    def is_suspended(self, owner):
        return self.word(mapped(owner, 10))[7] != 0


def shown(missing, broken, find):
    """What is found in the state, or why not."""
    try:
        return find()
    except NotShown:
        raise Unproven(missing) from None
    except Broken:
        raise Refused(broken) from None
