"""The bytes of a record: its header, and its head once it is opened (crates/gateway/src/PROTOCOL.md, section 9)."""
import struct

from .ciphers import gcm_open
from .errors import Refused
from .hashes import expand, sm3
from .packed import LARGEST_MESSAGE

LARGEST_HEAD, LARGEST_BODY = 64 * 1024, 64 * 2 ** 20 + 16


class Header:
    """What anybody may see, from the first bytes of a record."""

    def __init__(self, record):
        at = 10

        def take(length):
            nonlocal at
            at += length
            if at > len(record):
                raise Refused("not_a_record", "it ends too early")
            return record[at - length:at]

        if record[:10] != b"\x89AuthROS\x01\x01":
            raise Refused("not_a_record", "not a record of this version and suite")
        self.kind, self.domain, self.owner, self.signer, self.epoch = take(1)[0], take(32), take(20), take(32), take(8)
        self.recorder, self.number, self.topic, filters = take(16), take(8), take(16), take(1)[0]
        if filters > 4:
            raise Refused("not_a_record", "it has too many filters")
        take(8 * filters)
        self.time, self.head_length = struct.unpack(">QI", take(12))
        self.body_length, self.salt, self.commit = int.from_bytes(take(8), "big"), take(24), take(32)
        self.seq, self.length = int.from_bytes(self.number, "big"), at
        bounds = [1 <= self.kind <= 9, 16 <= self.head_length <= LARGEST_HEAD, 16 <= self.body_length <= LARGEST_BODY,
                  1 <= int.from_bytes(self.epoch, "big") < 1 << 63, 1 <= self.seq <= 1 << 40, self.time < 1 << 63]
        # Kind (1: a ledger, 2: a ring), seven random bytes, and a tag of the key that signs.
        if not all(bounds) or self.recorder[0] not in (1, 2) or self.recorder[8:] != self.signer[:8]:
            raise Refused("not_a_record", "a field has a value that no record has")

    def expect_length(self, length):
        if length != self.length + self.head_length + self.body_length:
            raise Refused("not_a_record", "its length differs from what its header says")

    def leaf(self, digest):
        return sm3(b"\0" + self.owner + self.signer + self.recorder + self.topic + self.number + digest)


def parse_head(head):
    at = 0

    def take(length):
        nonlocal at
        at += length
        if at > len(head):
            raise Refused("bad_disclosure", "the head ends too early")
        return head[at - length:at]

    def word():
        return take(int.from_bytes(take(2), "big")).decode()

    found = {name: word() for name in ("topic", "type", "md5sum")}
    found["definition"], found["publisher"], found["boot_id"] = take(32).hex(), word(), take(16).hex()
    found["compression"], found["plain_length"] = take(1)[0], int.from_bytes(take(8), "big")
    tags = [(word(), word()) for _ in range(tag_count(take(2)))]
    names = [name.encode() for name, _ in tags]
    found["tags"] = dict(tags)
    if at != len(head) or names != sorted(set(names)) or found["compression"] > 2:
        raise Refused("bad_disclosure", "the head is not of its form")
    return found


def tag_count(data):
    count = int.from_bytes(data, "big")
    if count > 64:
        raise Refused("bad_disclosure", "the head has too many tags")
    return count


def unsealed(record, header, secret):
    """Head, and the body as it was packed."""
    seq = header.number
    info = b"AuthROS/record/1" + header.domain + header.owner + header.recorder + header.epoch + seq
    keys = expand(secret, info, 88)
    if keys[56:] != header.commit:
        raise Refused("bad_disclosure", "the secret does not belong to the record")
    aad, sealed = record[:header.length], record[header.length:]
    try:
        head = gcm_open(keys[28:44], keys[44:56], aad, sealed[:header.head_length])
        body = gcm_open(keys[:16], keys[16:28], aad, sealed[header.head_length:])
        head = parse_head(head)
    except UnicodeDecodeError:
        raise Refused("bad_disclosure", "the head has a text that is none") from None
    length, is_packed = head["plain_length"], head["compression"] > 0
    if not (len(body) < length <= LARGEST_MESSAGE if is_packed else len(body) == length):
        raise Refused("bad_disclosure", "the message has another length")
    return head, body
