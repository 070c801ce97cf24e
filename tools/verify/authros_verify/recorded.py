"""A recorded file compared with what an opened record states of it."""
import pathlib
import struct

from .hashes import running_sm3

MOST_CHUNKS = 1 << 19


class Stated:
    """Name, length and digest of a file, and its chunks: begin, length, digest."""

    def __init__(self, body):
        self.at, self.body = 0, body
        if self.text() != "authros.recording" or self.length() != len(body) - self.at:
            raise ValueError("it is no such statement")
        own, self.chunks, after = [], [], 0
        while self.at < len(body):
            name, value = self.text(), self.text()
            if not name.startswith("chunk "):
                own.append((name, value))
                continue
            length, digest = value.split(" ")
            begins = int(name[6:])
            if begins < after or len(self.chunks) == MOST_CHUNKS:
                raise ValueError("its chunks are in another order, or too many")
            after = begins + int(length)
            self.chunks.append((begins, int(length), bytes.fromhex(digest)))
        found = dict(own)
        self.name, self.size, self.digest = found["name"], int(found["length"]), bytes.fromhex(found["sm3"])
        digests = [self.digest, *(digest for _, _, digest in self.chunks)]
        # There is one way to write it.
        if self.spelled(found["closed"]) != body[25:] or max(after, self.size) >= 1 << 64 or any(len(one) != 32 for one in digests):
            raise ValueError("it is spelled in another way")

    def length(self):
        self.at += 4
        return struct.unpack_from("<I", self.body, self.at - 4)[0]

    def text(self):
        length = self.length()
        self.at += length
        if self.at > len(self.body):
            raise ValueError("a text is longer than the statement")
        return self.body[self.at - length:self.at].decode()

    def spelled(self, closed):
        if closed not in ("yes", "no"):
            raise ValueError("it is neither closed nor open")
        lines = [("name", self.name), ("length", str(self.size)), ("sm3", self.digest.hex()), ("closed", closed)]
        lines += [(f"chunk {begins}", f"{size} {digest.hex()}") for begins, size, digest in self.chunks]
        return b"".join(struct.pack("<I", len(one.encode())) + one.encode() for line in lines for one in line)

    def compare(self, path):
        """Whether all of the file is as stated, its length, and where the chunks begin that differ."""
        whole, differing, length = running_sm3(), [], 0
        with open(path, "rb") as file:
            for at, size, digest in self.chunks:
                length += feed(file, max(0, at - length), [whole])
                own = running_sm3()
                read = feed(file, size, [whole, own])
                length += read
                if read != size or own.digest() != digest:
                    differing.append(at)
            length += feed(file, None, [whole])
        return length == self.size and whole.digest() == self.digest, length, differing


def feed(file, left, hashes):
    done = 0
    while left is None or done < left:
        block = file.read(1 << 18 if left is None else min(left - done, 1 << 18))
        if not block:
            break
        done += len(block)
        for one in hashes:
            one.update(block)
    return done


def statement(record):
    if record.head is None or record.opened.standing == "refused":
        return None
    is_named = (record.head["topic"], record.head["type"]) == ("authros/attachments", "authros/Metadata")
    if not is_named or record.head["tags"].get("recorded") != "file":
        return None
    try:
        return Stated(record.body)
    except (ValueError, KeyError, struct.error):
        return None


def compared(path, records):
    """How a recorded file compares with the statements that are opened in the bundle."""
    worst = None
    for record in records:
        stated = statement(record)
        if stated is None:
            continue
        whole, length, differing = stated.compare(path)
        one = {"standing": "proven" if whole else "refused", "record": record.digest.hex(), "name": stated.name,
               "bytes": length, "chunks": len(stated.chunks), "differing": differing[:100]}
        if whole:
            return one
        worst = worst or one
    return worst or {"standing": "absent", "record": None, "name": None, "bytes": pathlib.Path(path).stat().st_size, "chunks": 0, "differing": []}
