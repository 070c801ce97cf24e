"""A second reader of records, written from crates/gateway/src/PROTOCOL.md, section 10, with nothing but the standard library;
SM3, SM4 and LZ4 are those of tools/verify.

    second_reader.py FOLDER EK_HEX IK_HEX

Opens the record of a `records export` folder by its epoch's key, checks digest, signature, commit, tags and the Merkle path, and
prints what it found as JSON. It ends with an error where anything does not hold.
"""
import hmac
import json
import pathlib
import struct
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tools" / "verify"))

from authros_verify.ciphers import SBOX, sm4, sm4_keys  # noqa: E402
from authros_verify.hashes import hmac_sm3, sm3  # noqa: E402
from authros_verify.packed import lz4  # noqa: E402


def fields(data, *widths):
    at = 0
    for width in widths:
        yield data[at:at + width]
        at += width


def hkdf(key, salt, info, length):  # RFC 5869
    prk, out, block = hmac_sm3(salt or bytes(32), key), b"", b""
    for number in range(1, -(-length // 32) + 1):
        block = hmac_sm3(prk, block + info + bytes([number]))
        out += block
    return out[:length]


def text(value):
    value = value.encode()
    return struct.pack(">H", len(value)) + value


assert (SBOX[0x00], SBOX[0x01], SBOX[0xEF], SBOX[0xFF]) == (0xD6, 0x90, 0x84, 0x48), "SM4's S-box"


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
        raise SystemExit("a tag does not hold")
    stream = b"".join(sm4(keys, nonce + struct.pack(">I", n + 2)) for n in range(-(-len(text_) // 16)))
    return bytes(a ^ b for a, b in zip(text_, stream))


# GB/T 32918: the recommended curve.
P = 0xFFFFFFFEFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFF00000000FFFFFFFFFFFFFFFF
A = P - 3
B = 0x28E9FA9E9D9F5E344D5A9E4BCF6509A7F39789F515AB8F92DDBCBD414D940E93
N = 0xFFFFFFFEFFFFFFFFFFFFFFFFFFFFFFFF7203DF6B21C6052B53BBF40939D54123
G = (0x32C4AE2C1F1981195F9904466A39C9948FE30BBFF2660BE1715A4589334C74C7,
     0xBC3736A2F4F6779C59BDCEE36B692153D0A9877CC62A474002DF32E52139F0A0)


def add(p, q):
    if p is None or q is None:
        return p or q
    if p[0] == q[0] and (p[1] + q[1]) % P == 0:
        return None
    slope = (3 * p[0] * p[0] + A) * pow(2 * p[1], -1, P) if p == q else (q[1] - p[1]) * pow(q[0] - p[0], -1, P)
    x = (slope * slope - p[0] - q[0]) % P
    return x, (slope * (p[0] - x) - p[1]) % P


def mul(k, p):
    total = None
    while k:
        total, p, k = add(total, p) if k & 1 else total, add(p, p), k >> 1
    return total


def sm2_verify(public, message, r, s):
    point = tuple(int.from_bytes(public[at:at + 32], "big") for at in (0, 32))
    number = lambda x: x.to_bytes(32, "big")
    name = b"1234567812345678"
    z = sm3(struct.pack(">H", len(name) * 8) + name + b"".join(map(number, (A, B, *G, *point))))
    e = int.from_bytes(sm3(z + message), "big")
    t = (r + s) % N
    return 0 < r < N and 0 < s < N and t != 0 and (e + add(mul(s, G), mul(t, point))[0]) % N == r


def der_numbers(der):  # SEQUENCE of two INTEGERs
    length = der[3]
    return int.from_bytes(der[4:4 + length], "big"), int.from_bytes(der[6 + length:], "big")


def parse_header(record):
    if record[:10] != b"\x89AuthROS\x01\x01":
        raise SystemExit("no record of this version and suite")
    names = ("kind", "domain", "owner", "signer", "epoch", "recorder", "seq", "topic_id", "count")
    header = dict(zip(names, fields(record[10:], 1, 32, 20, 32, 8, 16, 8, 16, 1)))
    at = 10 + 134
    header["filters"] = [record[at + 8 * n:at + 8 * n + 8] for n in range(header["count"][0])]
    at += 8 * len(header["filters"])
    names = ("time", "head_length", "body_length", "salt", "commit")
    header.update(zip(names, fields(record[at:], 8, 4, 8, 24, 32)))
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
        raise SystemExit("bytes behind the head")
    return found


def root_of(leaf, index, count, path):  # RFC 9162, 2.1.3.2
    place, last, h = index, count - 1, leaf
    for p in path:
        if last == 0:
            raise SystemExit("the path is too long")
        if place & 1 or place == last:
            h = sm3(b"\1" + p + h)
            while place & 1 == 0 and place:
                place, last = place >> 1, last >> 1
        else:
            h = sm3(b"\1" + h + p)
        place, last = place >> 1, last >> 1
    return h if last == 0 else None


def main(folder, ek, ik):
    folder = pathlib.Path(folder)
    record, proof = (folder / "record.bin").read_bytes(), json.loads((folder / "proof.json").read_text())
    unhex = lambda value: bytes.fromhex(value.removeprefix("0x"))
    header, length = parse_header(record)
    digest = sm3(record)
    head_length = int.from_bytes(header["head_length"], "big")
    body_length = int.from_bytes(header["body_length"], "big")
    assert len(record) == length + head_length + body_length, "length"
    assert digest == unhex(proof["digest"]), "digest"
    signer = unhex(proof["signing_key"])[-64:]
    assert sm3(b"\4" + signer) == header["signer"], "the signer's id"
    signed = b"AuthROS/signature/1" + header["domain"] + digest
    assert sm2_verify(signer, signed, *der_numbers((folder / "signature.bin").read_bytes())), "signature"

    topic_key = hkdf(unhex(ek), b"", b"AuthROS/topic/1" + header["topic_id"], 32)
    info = b"AuthROS/record/1" + b"".join(header[name] for name in ("domain", "owner", "recorder", "epoch", "seq"))
    keys = hkdf(topic_key, header["salt"], info, 88)
    body_key, body_nonce, head_key, head_nonce, commit = fields(keys, 16, 12, 16, 12, 32)
    assert commit == header["commit"], "commit"
    aad, sealed = record[:length], record[length:]
    head = parse_head(gcm_open(head_key, head_nonce, aad, sealed[:head_length]))
    body = gcm_open(body_key, body_nonce, aad, sealed[head_length:])
    body = {0: lambda: body, 1: lambda: lz4(body, head["plain_length"])}[head["compression"]]()
    assert len(body) == head["plain_length"], "plain length"
    index = unhex(ik)
    assert hkdf(index, b"", b"AuthROS/topicid/1" + text(head["topic"]), 16) == header["topic_id"], "topic id"
    by_type = hkdf(index, b"", b"AuthROS/filterid/1" + text("type") + text(head["type"]), 8)
    assert by_type == header["filters"][0], "filter of the type"

    anchor = proof["anchor"]
    leaf = sm3(b"\0" + b"".join(header[name] for name in ("owner", "signer", "recorder", "topic_id", "seq")) + digest)
    if anchor["mode"] == "batch":
        path = [unhex(step) for step in anchor["path"]]
        assert root_of(leaf, anchor["index"], anchor["count"], path) == unhex(anchor["root"]), "path"
    print(json.dumps({
        "digest": digest.hex(), "seq": int.from_bytes(header["seq"], "big"), "head": head, "body": body.hex(),
        "captured_ns": int.from_bytes(header["time"], "big"), "anchor": anchor["mode"],
    }))


if __name__ == "__main__":
    main(*sys.argv[1:])
