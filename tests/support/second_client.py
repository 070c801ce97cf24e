"""A second client of a gateway, written from crates/gateway/src/PROTOCOL.md with nothing but the standard library; SM2, SM3 and SM4
are those of tools/verify.

    second_client.py HOST:PORT DOMAIN FINGERPRINT NAME TRANSPORT_KEY TOKEN OWNER

Greets the gateway, proves itself with the transport key, follows an owner's records from the beginning of the feed to its head, and
fetches them. Signatures, digests and Merkle paths are checked. Prints the feed's id, its head and the records as JSON; ends with an
error where anything does not hold.
"""
import json
import pathlib
import secrets
import socket
import struct
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tools" / "verify"))

from authros_verify.bundle import der_of, root_of  # noqa: E402
from authros_verify.ciphers import sm4, sm4_keys  # noqa: E402
from authros_verify.curves import SM2, combined, is_sm2_point, point_of, sm2_verify  # noqa: E402
from authros_verify.hashes import expand, hmac_sm3, sm3  # noqa: E402
from authros_verify.record import Header  # noqa: E402

HELLO, ANSWER, IDENTIFY, TRANSFER, REFUSAL = 1, 2, 3, 4, 5
FEED, RECORDS, PING, REFUSE = 6, 7, 13, 16
FACTS = {1: "stored", 2: "verified", 3: "erased"}


def number(data):
    return int.from_bytes(data, "big")


def fields(data, *widths):
    at = 0
    for width in widths:
        yield data[at:at + width]
        at += width


def need(holds, what):
    if not holds:
        raise SystemExit(f"it does not hold: {what}")


def hkdf(key, salt, info, length):
    return expand(hmac_sm3(salt, key), info, length)


class Gcm:  # NIST SP 800-38D over SM4, RFC 8998
    def __init__(self, key):
        self.keys = sm4_keys(key)
        self.h = number(sm4(self.keys, bytes(16)))

    def times(self, x):
        product, v = 0, self.h
        for bit in range(127, -1, -1):
            product ^= v if x >> bit & 1 else 0
            v = (v >> 1) ^ (0xE1 << 120 if v & 1 else 0)
        return product

    def stream(self, nonce, text):
        blocks = (sm4(self.keys, nonce + struct.pack(">I", n + 2)) for n in range(-(-len(text) // 16)))
        return bytes(a ^ b for a, b in zip(text, b"".join(blocks)))

    def tag(self, nonce, aad, text):
        pad = lambda data: data + bytes(-len(data) % 16)
        y, hashed = 0, pad(aad) + pad(text) + struct.pack(">2Q", len(aad) * 8, len(text) * 8)
        for at in range(0, len(hashed), 16):
            y = self.times(y ^ number(hashed[at:at + 16]))
        return bytes(a ^ b for a, b in zip(sm4(self.keys, nonce + b"\0\0\0\1"), y.to_bytes(16, "big")))

    def seal(self, nonce, aad, text):
        sealed = self.stream(nonce, text)
        return sealed + self.tag(nonce, aad, sealed)

    def open(self, nonce, aad, sealed):
        text, tag = sealed[:-16], sealed[-16:]
        need(secrets.compare_digest(tag, self.tag(nonce, aad, text)), "the tag of a frame")
        return self.stream(nonce, text)


class Reader:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, length):
        self.at += length
        need(self.at <= len(self.data), "the length of an answer")
        return self.data[self.at - length:self.at]

    def number(self, length):
        return number(self.take(length))

    def end(self):
        need(self.at == len(self.data), "the end of an answer")


class Session:
    def __init__(self, address, domain, fingerprint, name, transport_key, token):
        host, port = address.rsplit(":", 1)
        self.line = socket.create_connection((host, int(port)), timeout=60)
        self.domain, self.token, self.requests = domain, token, 0
        secret = secrets.randbelow(SM2.n - 2) + 1
        point = b"".join(x.to_bytes(32, "big") for x in combined(SM2, secret, 0, SM2.g))
        hello = b"\1\1" + domain + secrets.token_bytes(32) + point
        self.send(HELLO, hello)
        answer = self.frame(ANSWER)
        need(len(answer) == 282 and answer[:2] == b"\1\1", "the form of the answer to the hello")
        _, _, theirs, self.id, _, _, self.identity, signature = fields(answer, 2, 32, 64, 16, 8, 32, 64, 64)
        need(sm3(b"\4" + self.identity) == fingerprint, "the gateway's fingerprint")
        transcript = sm3(b"AuthROS/transcript/1" + domain + hello + answer[:-64])
        need(sm2_verify(self.identity, b"AuthROS/hello/1" + domain + transcript, der_of(signature)), "its signature")
        need(is_sm2_point(theirs), "its point")
        shared = combined(SM2, 0, secret, point_of(theirs))[0].to_bytes(32, "big")
        keys = hkdf(shared, transcript, b"AuthROS/identify/1", 28)
        named = bytes([1, len(name)]) + name.ljust(32, b"\0")
        identify = Gcm(keys[:16]).seal(keys[16:], b"AuthROS/identify/1" + self.id, named)
        self.send(IDENTIFY, identify)
        salt = sm3(b"AuthROS/transcript/1" + transcript + identify)
        keys = [hkdf(shared + transport_key, salt, b"AuthROS/session/1" + bytes([way]), 28) for way in (1, 2)]
        (self.sealing, self.ours), (self.opening, self.theirs) = ((Gcm(key[:16]), key[16:]) for key in keys)
        self.sent = self.heard = 0
        Reader(self.ask(PING, b"")).take(8)

    def send(self, kind, payload):
        self.line.sendall(struct.pack(">IB", len(payload) + 1, kind) + payload)

    def receive(self, length):
        data = b""
        while len(data) < length:
            more = self.line.recv(length - len(data))
            need(more, "the connection")
            data += more
        return data

    def frame(self, kind):
        length = number(self.receive(4))
        need(0 < length <= 1 << 20, "the length of a frame")
        found, payload = fields(self.receive(length), 1, length - 1)
        need(found[0] == kind, f"a frame of kind {kind}, not {found[0]} {payload[:2].hex()}")
        return payload

    def nonce(self, iv, counter):
        return iv[:4] + (number(iv[4:]) ^ counter).to_bytes(8, "big")

    def heard_message(self):
        payload = self.frame(TRANSFER)
        session, counter = payload[:16], number(payload[16:24])
        need(session == self.id and counter == self.heard, "session and counter of a frame")
        self.heard += 1
        text = self.opening.open(self.nonce(self.theirs, counter), bytes([TRANSFER]) + payload[:24], payload[24:])
        return text[0], text[1], number(text[2:6]), text[6:]

    def ask(self, command, body):
        self.requests += 1
        text = bytes([command, 0]) + struct.pack(">I", self.requests) + self.token + body
        head = self.id + struct.pack(">Q", self.sent)
        self.send(TRANSFER, head + self.sealing.seal(self.nonce(self.ours, self.sent), bytes([TRANSFER]) + head, text))
        self.sent += 1
        answered, part, request, whole = self.heard_message()
        if part == 1:
            total, whole = number(whole[:4]), whole[4:]
            while part != 3:
                _, part, _, more = self.heard_message()
                whole += more
            need(len(whole) == total, "the length of a message in parts")
        need(request == self.requests, "the number of an answer")
        need(answered != REFUSE + 128, f"refused with code {whole[:2].hex()}")
        need(answered == command + 128, "the Command of an answer")
        return whole

    def page(self, feed, owner, after):
        """The next page: its feed, whether that is read anew, head, upto, and entries. By whichever grant is in force."""
        body = feed + bytes(2) + bytes(1) + bytes(1) + bytes(1) + struct.pack(">H", 1) + owner + struct.pack(">2Q", after, 0)
        answer = Reader(self.ask(FEED, body))
        feed, anew, head, upto = answer.take(16), answer.number(1), answer.number(8), answer.number(8)
        need(anew in (0, 1), "whether a feed is read anew")
        need(answer.number(2) == 0, "this owner gives nothing")
        entries, told = [], b""
        for _ in range(answer.number(2)):
            names = ("number", "fact", "digest", "owner", "recorder", "seq", "topic_id", "epoch", "time", "length", "kind")
            entry = dict(zip(names, (answer.take(width) for width in (8, 1, 32, 20, 16, 8, 16, 8, 8, 8, 1))))
            entry["proof"] = answer.take(answer.number(4))
            told += entry["digest"] + entry["fact"] + (sm3(entry["proof"]) if entry["proof"] else bytes(32))
            entries.append(entry)
        time, signature = answer.take(8), answer.take(64)
        answer.end()
        if entries:
            signed = b"AuthROS/feed/1" + self.domain + time + struct.pack(">H", len(entries)) + told
            need(sm2_verify(self.identity, signed, der_of(signature)), "the signature of a page")
        return feed, anew, head, upto, entries

    def records(self, digests):
        """What there is of each: (code of what it is, record)."""
        found = []
        while len(found) < len(digests):
            left = digests[len(found):]
            answer = Reader(self.ask(RECORDS, b"\1" + struct.pack(">H", len(left)) + b"".join(left)))
            count = answer.number(2)
            need(1 <= count <= len(left), "the number of records")
            for _ in range(count):
                what = answer.number(1)
                found.append((what, answer.number(2) if what == 0 else answer.take(answer.number(4))))
            answer.end()
        return found


def path_of(proof):
    """Index, leaves, root and steps of a batched proof."""
    reader = Reader(proof)
    need(reader.take(1) == b"\1", "the version of a proof")
    reader.take(20 + 32 + 8 + 32)
    need(reader.take(1) == b"\1", "a proof of a batch")
    index, leaves, root = reader.number(8), reader.number(8), reader.take(32)
    steps = [reader.take(32) for _ in range(reader.number(1))]
    reader.end()
    return index, leaves, root, steps


def checked(session, entry, what, record):
    """A record as told and fetched; everything that can be checked without the chain was."""
    told = {"number": number(entry["number"]), "fact": FACTS[entry["fact"][0]], "digest": entry["digest"].hex(),
            "seq": number(entry["seq"])}
    if what == 0:
        return told | {"refused": record}
    reader = Reader(record)
    signer, signature, proof = reader.take(64), reader.take(64), reader.take(reader.number(4))
    blob = record[reader.at:] if what == 2 else record[reader.at:-168]
    header = Header(blob)
    found = {"owner": header.owner, "recorder": header.recorder, "seq": header.number, "topic_id": header.topic,
             "epoch": header.epoch, "time": struct.pack(">Q", header.time), "kind": bytes([header.kind])}
    for name, value in found.items():
        need(value == entry[name], f"its {name} is that of the entry")
    need(header.domain == session.domain and header.signer == sm3(b"\4" + signer), "its network and its signer")
    signed = b"AuthROS/signature/1" + session.domain + entry["digest"]
    need(sm2_verify(signer, signed, der_of(signature)), "the signature of a record")
    if what == 2:
        need(sm3(blob) == entry["digest"], "the digest of a record")
    index, leaves, root, steps = path_of(proof)
    need(proof == entry["proof"], "one proof, told and fetched")
    need(root_of(header.leaf(entry["digest"]), index, leaves, steps) == root, "its path leads to its root")
    return told | {"header": header.length, "bytes": len(blob), "root": root.hex()}


def main(address, domain, fingerprint, name, transport_key, token, owner):
    hexed = bytes.fromhex
    session = Session(address, hexed(domain), hexed(fingerprint), name.encode(), hexed(transport_key), hexed(token))
    feed, upto, records = bytes(16), 0, []
    while True:
        feed, anew, head, next_upto, entries = session.page(feed, hexed(owner), upto)
        upto = max(0 if anew else upto, next_upto)
        fetched = session.records([entry["digest"] for entry in entries]) if entries else []
        records += [checked(session, entry, *found) for entry, found in zip(entries, fetched)]
        if upto == head:
            break
    print(json.dumps({"feed": feed.hex(), "head": upto, "records": records}))


if __name__ == "__main__":
    main(*sys.argv[1:])
