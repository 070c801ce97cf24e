#!/usr/bin/env python3
"""Random mutations of a real bundle, by a seed: all verifiers come to the same outcome, level by level.

usage: mutate.py BUNDLE TRUST OWNER FOLDER --verifier NAME=COMMAND ... [--seed N] [--count N | --seconds N] [--only N]

OWNER is the key of the records' owner, PKCS#8 PEM: its owner is who could lie best. The first verifier is tools/verify, in this
process. Each COMMAND reads a list of {"bundle": PATH, "trust": PATH} as JSON and prints the list of what `--json` has of each, or
{"trust": WHY} where the trust file cannot be used; `program:PATH` stands for the program itself. What differs stays in FOLDER, and
`--only N` makes case N of a seed once more.
"""
import argparse
import collections
import hashlib
import json
import os
import pathlib
import random
import struct
import subprocess
import sys
import time
import zlib

from forge import (
    Account, SmKey, extended, file_of, identity_of, resealed, sealed_again, secrets_of, signed, trust_of, with_disclosures, with_manifest, with_word,
)
from authros_verify import TrustError, record, state, verify
from authros_verify.archive import unhex, unpacked
from authros_verify.state import mapped
from authros_verify.trust import read_trust

AT_ONCE = 40
LEVELS = ("bytes", "key", "anchor", "time", "opened")


class Case:
    """A bundle in the making: its members, its pins, and what was done to it."""

    def __init__(self, base, draw):
        self.draw, self.base, self.members, self.trust, self.done = draw, base, dict(base.members), base.trust, [base.name]
        self.exporter, self.account, self.is_signed = base.key, base.account, True

    def name(self, *parts):
        """A member whose name has one of these parts, or None."""
        names = sorted(name for name in self.members if any(part in name for part in parts))
        return self.draw.choice(names) if names else None

    def document(self, name):
        return json.loads(self.members[name])

    def put(self, name, document):
        self.members[name] = json.dumps(document).encode()

    def file(self):
        members = signed(self.members, self.exporter, self.account) if self.is_signed else self.members
        return file_of(members)


class Base:
    """A real bundle as it is, or sealed again by signers that a reader pins."""

    def __init__(self, name, members, trust, key, account, sealers):
        self.name, self.members, self.trust, self.key, self.account, self.sealers = name, members, trust, key, account, sealers


def bases(bundle, trust, owner, draw):
    members, text = unpacked(pathlib.Path(bundle).read_bytes()), pathlib.Path(trust).read_text(encoding="utf-8")
    pins, chain = read_trust(trust), json.loads(members["manifest.json"])["chain"]
    key, sealers = SmKey(draw), [Account(draw) for _ in range(3)]
    account = "0x" + "07" * 20
    owner, owners = SmKey.of_pem(draw, owner), json.loads(members["manifest.json"])["exporter"]["account"]
    authorities = text[text.index("[[authority]]"):] if "[[authority]]" in text else ""
    person = [(account, "the forger", key.id)]
    foreign = trust_of(chain, pins.code_hash.hex(), sealers, person, "\n" + authorities)
    unnamed = trust_of(chain, pins.code_hash.hex(), sealers[:2], (), "", "quorum = 1\n")
    made = [Base("as it is", members, text, owner, owners, [])]
    members = extended(members, 2)
    for consensus in ("clique", "qbft", "ibft"):
        sealed = resealed(members, sealers, consensus)
        made.append(Base(consensus, sealed, foreign, key, account, sealers))
    by_owner = trust_of(chain, pins.code_hash.hex(), sealers, (), "\n" + authorities)
    made.append(Base("by its owner", resealed(members, sealers, "clique"), by_owner, owner, owners, sealers))
    made.append(Base("unnamed", resealed(members, sealers, "clique"), unnamed, key, account, sealers))
    return made


# Each changes a case, or returns False where there is nothing of its kind. All are drawn alike.

def flip(case):
    name = case.name("")
    data = bytearray(case.members[name])
    if not data:
        return False
    for _ in range(case.draw.choice((1, 1, 2))):
        data[case.draw.randrange(len(data))] ^= 1 << case.draw.randrange(8)
    case.members[name] = bytes(data)


def cut_or_grow(case):
    name, data = case.name(""), None
    data = case.members[name]
    at = case.draw.randrange(len(data) + 1)
    some = bytes(case.draw.randrange(256) for _ in range(case.draw.randrange(1, 4)))
    case.members[name] = case.draw.choice((data[:at], data[at:], data[:at] + some + data[at:], data + some, data + data[:at], b""))


def swap_members(case):
    one = case.name("records/", "chain/", "stamps/", "identities/", "keys/")
    kind = one.rsplit("/", 1)[-1] if one.startswith(("records", "stamps")) else one.split("/")[0]
    other = case.name(kind)
    case.members[one], case.members[other] = case.members[other], case.members[one]
    return one != other


def remove(case):
    del case.members[case.name("")]


def rename(case):
    one = case.name("/")
    digits = [at for at, sign in enumerate(one) if sign in "0123456789abcdef"]
    at = case.draw.choice(digits)
    case.members[one[:at] + case.draw.choice("0123456789abcdefABg.") + one[at + 1:]] = case.members.pop(one)


def places(document, path=()):
    yield path
    if isinstance(document, (dict, list)):
        for name in (document if isinstance(document, dict) else range(len(document))):
            yield from places(document[name], (*path, name))


def change_json(case):
    name = case.name(".json")
    document = case.document(name)
    *path, last = case.draw.choice([place for place in places(document) if place])
    holder = document
    for one in path:
        holder = holder[one]
    value = holder[last]
    if isinstance(value, int):
        holder[last] = case.draw.choice((value + 1, max(value - 1, 0), 0, 2 ** 63, 2 ** 64 - 1, 2 ** 64, value * 2, str(value), float(value), -value))
    elif isinstance(value, str) and value:
        at = case.draw.randrange(len(value))
        other = case.draw.choice("0123456789abcdefABx/")
        holder[last] = case.draw.choice((value[:at] + other + value[at + 1:], value[1:], value.upper(), value.lower(), "0x" + value, value + "0", None))
    elif isinstance(value, list) and value:
        at = case.draw.randrange(len(value))
        holder[last] = case.draw.choice((value[1:], value[:-1], value[::-1], [*value, value[at]], [value[at], *value], []))
    else:
        holder[last] = case.draw.choice((None, [], {}, 0, "", list(value.values()) if isinstance(value, dict) else [value]))
    if name == "manifest.json":
        case.members, case.is_signed = with_manifest(case.members, json.dumps(document).encode(), case.exporter), False
    else:
        case.put(name, document)


def change_anchor(case):
    name = case.name("anchor.json")
    other = case.name("anchor.json")
    if name is None:
        return False
    claim, another = case.document(name), case.document(other)
    field = case.draw.choice(("block", "shown_at", "keys", "anchor", "index", "count", "path", "root", "each"))
    if field in ("block", "shown_at", "keys"):
        claim[field] = case.draw.choice((claim[field] + 1, max(0, claim[field] - 1), another[field], 0, 2 ** 64 - 1))
    elif field == "anchor":
        claim["anchor"] = another["anchor"]
    elif field == "each":
        claim["anchor"] = {"mode": "each"}
    elif field in claim["anchor"] and field in another["anchor"]:
        claim["anchor"][field] = another["anchor"][field] if field in ("path", "root") else claim["anchor"][field] + case.draw.choice((1, -1) if claim["anchor"][field] else (1,))
    case.put(name, claim)


def change_stamp(case):
    """Another token over the same imprint, tokens of another stamp, a token more."""
    tokens = [name for name in case.members if name.startswith("stamps/") and name.endswith(".der")]
    if not tokens:
        return False
    one, other = case.draw.choice(tokens), case.draw.choice(tokens)
    data = bytearray(case.members[other])
    if case.draw.random() < 0.6:
        at = case.draw.randrange(len(data))
        how = case.draw.randrange(3)
        if how == 0:
            data[at] ^= 1 << case.draw.randrange(8)
        elif how == 1:
            del data[at]
        else:
            data.insert(at, case.draw.randrange(256))
    if case.draw.random() < 0.5:
        del case.members[one]
    case.members[one.rsplit("/", 1)[0] + "/" + hashlib.sha256(data).hexdigest()[:32] + ".der"] = bytes(data)


def change_header(case):
    """A field of a header, which is then sealed again, or not."""
    numbers = [name for name in case.members if name.startswith("chain/") and name != "chain/nodes.rlp"]
    name = case.draw.choice(numbers)
    header = state.rlp(case.members[name])
    at = case.draw.choice((0, 3, 8, 11, 11, 12, 13, 14, len(header) - 1))
    value = header[at]
    number = int.from_bytes(value, "big") if len(value) <= 8 else 0
    packed = lambda number: number.to_bytes((number.bit_length() + 7) // 8, "big")
    flipped = bytes([value[0] ^ 1]) + value[1:] if value else b"\1"
    header[at] = case.draw.choice((flipped, value[:-1], value + b"\0", b"\0" + value, packed(number + 1), packed(max(0, number - 1)), b"", [value], packed(2 ** 64)))
    case.members[name] = state.encode(header)
    seal_again(case)


def seal_again(case):
    try:
        if case.base.sealers and case.draw.random() < 0.8:
            consensus = case.base.name if case.base.name in ("qbft", "ibft") else "clique"
            some = case.draw.sample(case.base.sealers, case.draw.choice((1, 2, 3, 3)))
            if case.draw.random() < 0.15:
                some.append(case.draw.choice((some[0], Account(case.draw))))
            case.members = resealed(case.members, some, consensus)
            return True
    except (ValueError, IndexError, TypeError):
        pass
    return False


def change_seals(case):
    return seal_again(case)


def change_state(case):
    """A word of the contract's storage, with all hashes up to the header, which is then sealed again."""
    anchor = case.name("anchor.json")
    if anchor is None:
        return False
    try:
        claim = case.document(anchor)
        blob = case.members[anchor.replace("anchor.json", "record.bin")]
        owner, signer, how = blob[43:63], blob[63:95], claim["anchor"]
        contract = unhex(json.loads(case.members["manifest.json"])["chain"]["contract"])
        block, keys = claim["block"], claim["keys"]
        n = lambda *numbers: b"".join(struct.pack(">Q", one) for one in reversed(numbers)).rjust(32, b"\0")
        some = case.draw.choice((0, 1, block - 1, block, block + 1, 2 ** 64 - 1))
        at = int.from_bytes(state.rlp(case.members[f"chain/{claim['shown_at']}.rlp"])[11], "big")
        times = case.draw.choice((0, 1, at, at - 1, at + 1, 2 ** 63, 2 ** 64 - 1))
        account = unhex(how.get("account", "0x" + owner.hex()))
        slot, word = case.draw.choice([
            (mapped(unhex(how.get("root", "00" * 32)), mapped(account, 8)), n(some, how.get("count", 1), times, keys)),
            (mapped(unhex(how.get("root", "00" * 32)), mapped(account, 8)), n(block, case.draw.choice((0, 1, 2, how.get("count", 1))), at, case.draw.choice((keys, keys + 1, 0)))),
            (mapped(owner, 10), bytes(7) + bytes([case.draw.choice((0, 1, 2))]) + n(1, 0, 1)[8:]),
            (mapped(keys + 1, mapped(owner, 15)), bytes([3]) * 32),
            (after(mapped(keys + 1, mapped(owner, 15))), n(some, 1)),
            (after(mapped(keys, mapped(owner, 15))), n(some, 1)),
            (mapped(keys, mapped(owner, 15)), case.draw.choice((bytes([4]) * 32, bytes(32)))),
            (mapped(signer, mapped(owner, 9)), n(some, 0, times, case.draw.choice((0, block, block + 1)))[1:] + b"\1"),
            (mapped(bytes.fromhex(anchor.split("/")[1]), mapped(owner, 5)), n(some)),
        ])
        changed = with_word(case.members, contract, claim["shown_at"], slot, word)
    except (KeyError, ValueError, IndexError, TypeError, struct.error):
        return False
    if changed is None:
        return False
    case.members = changed
    seal_again(case)


def after(slot):
    return ((int.from_bytes(slot, "big") + 1) % 2 ** 256).to_bytes(32, "big")


def change_nodes(case):
    nodes = state.rlp(case.members["chain/nodes.rlp"])
    at = case.draw.randrange(len(nodes))
    how = case.draw.randrange(4)
    if how == 0:
        del nodes[at]
    elif how == 1:
        nodes.reverse()
    elif how == 2:
        nodes.insert(at, nodes[at])
    else:
        nodes[at] = nodes[at][:-1]
    case.members["chain/nodes.rlp"] = state.encode(nodes)


def change_message(case):
    """The head or the body of a disclosed record, sealed and signed again by another key, which discloses all as its own."""
    secrets = secrets_of(case.members)
    if not secrets:
        return False
    digest = case.draw.choice(sorted(secrets))
    folder = f"records/{digest.hex()}/"
    try:
        blob = case.members[folder + "record.bin"]
        header = record.Header(blob)
        head, body = record.unsealed(blob, header, secrets[digest])
    except Exception:
        return False
    key = case.exporter
    fields = [head["topic"], head["type"], head["md5sum"]]
    text = lambda word: struct.pack(">H", len(word.encode())) + word.encode()
    tags, length, how, end = sorted(head["tags"].items()), head["plain_length"], head["compression"], b""
    choice = case.draw.randrange(9)
    if choice == 0:
        length = case.draw.choice((length + 1, length - 1, len(body), 2 ** 26, 2 ** 26 + 1, 2 ** 40, 2 ** 63, 0))
    elif choice == 1:
        how = case.draw.choice((0, 1, 2, 3, 255))
    elif choice == 2:
        tags = case.draw.choice((tags[::-1], [("b", "1"), ("a", "2")], [("a", "1"), ("a", "2")], [(f"{at:03}", "") for at in range(case.draw.choice((64, 65)))], [("\u00e4", "1"), ("z", "2")]))
    elif choice == 3:
        end = b"\0"
    elif choice == 4:
        fields[0] = case.draw.choice(("authros/recorder", "/other", "", "\u202e/odom", "x" * 300))
    elif choice == 5:
        fields[1] = case.draw.choice(("authros/Heads", "authros/Birth", "authros/Metadata"))
    elif choice == 6 and body:
        body = bytearray(body)
        body[case.draw.randrange(len(body))] ^= 1 << case.draw.randrange(8)
        body = bytes(body)
    elif choice == 7:
        body, length, how = matrix(case.draw)
    written = b"".join(map(text, fields)) + bytes.fromhex(head["definition"]) + text(head["publisher"]) + bytes.fromhex(head["boot_id"])
    written += struct.pack(">BQH", how & 255, length, len(tags)) + b"".join(text(one) for tag in tags for one in tag) + end
    new, blob, signature = sealed_again(blob, header, secrets[digest], key, written, body)
    for part in [name for name in case.members if name.startswith(folder)]:
        content = case.members.pop(part)
        if part.endswith("anchor.json"):
            case.members[f"records/{new.hex()}/anchor.json"] = content
    case.members.update({f"records/{new.hex()}/record.bin": blob, f"records/{new.hex()}/signature.der": signature})
    secrets[new] = secrets.pop(digest)
    case.members = with_disclosures(case.members, secrets, key, header.domain)
    envelope = SmKey(case.draw)
    identity = identity_of(key, envelope, header.owner, header.domain)
    case.members[f"identities/{state.keccak(identity).hex()}.bin"] = identity


def matrix(draw):
    """A small matrix in its coded form, sometimes with one byte wrong: bytes, plain length, compression."""
    sample, channels, columns, rows = draw.choice((1, 2, 4)), draw.choice((1, 2, 3, 4)), draw.choice((16, 20)), draw.choice((4, 8))
    green = 0x40 if sample == 1 and channels > 2 and draw.random() < 0.5 else 0
    kinds = range(5) if sample == 1 else (1, 2)
    row = columns * channels * sample
    stream = b"".join(bytes([draw.choice(kinds)]) + bytes(draw.choice((0, 0, 1, 255)) for _ in range(row)) for _ in range(rows))
    front = struct.pack(">3I3B", 5, rows, columns, channels, sample | green | draw.choice((0, 0x80)), draw.choice((1, 2)))
    packed = bytearray(front + b"front" + b"end" + zlib.compress(stream, 9))
    if draw.random() < 0.6:
        packed[draw.choice((draw.randrange(15), draw.randrange(len(packed))))] ^= 1 << draw.randrange(8)
    return bytes(packed), 8 + rows * row + draw.choice((0, 0, 0, 1)), 2


def change_trust(case):
    text = case.trust
    at = case.draw.randrange(len(text))
    how = case.draw.randrange(6)
    if how == 0:
        case.trust = text.replace("sealed_by_exporter = false", "sealed_by_exporter = true")
    elif how == 1:
        case.trust = text.replace("[chain]", f"[chain]\nquorum = {case.draw.randrange(5)}", 1)
    elif how == 2:
        case.trust = text[:at] + case.draw.choice("0123456789abcdef\"'[]=.#\n ,\t") + text[at + 1:]
    elif how == 3:
        case.trust = text[:at] + case.draw.choice(("\n", " ", "#", "\"", "'", "\t", "\u00e9", "_", "+", "-", "\r\n", "\\")) + text[at:]
    elif how == 4:
        case.trust = text[:at] + text[at + 1:]
    else:
        lines = text.split("\n")
        case.draw.shuffle(lines) if case.draw.random() < 0.2 else lines.pop(case.draw.randrange(len(lines)))
        case.trust = "\n".join(lines)


def change_exporter(case):
    case.account = case.draw.choice(("0x" + "6a" * 20, case.account.lower(), case.account.upper().replace("0X", "0x")))
    if case.draw.random() < 0.5:
        case.exporter = SmKey(case.draw)


def leave_unsigned(case):
    """A byte of the file itself: nobody signs for it."""
    data = bytearray(case.file())
    at = case.draw.randrange(len(data))
    data[at] ^= 1 << case.draw.randrange(8)
    case.file = lambda: bytes(data)


MUTATIONS = [flip, cut_or_grow, swap_members, remove, rename, change_json, change_json, change_anchor, change_anchor, change_stamp, change_stamp,
             change_header, change_header, change_seals, change_state, change_state, change_state, change_state, change_nodes, change_message,
             change_message, change_message, change_message, change_trust, change_trust, change_exporter, leave_unsigned]


def made(all_, seed, number):
    """Case `number` of a seed."""
    draw = random.Random(f"{seed} {number}")
    case = Case(draw.choice(all_), draw)
    for _ in range(draw.choice((0, 1, 1, 1, 1, 2, 2, 3)) if number % 50 else 0):
        mutation = draw.choice(MUTATIONS)
        if (not case.is_signed or "file" in vars(case)) and mutation is not leave_unsigned:
            break
        if changed(case, mutation):
            case.done.append(mutation.__name__)
    return case


def changed(case, mutation):
    """Whether a mutation found something of its kind; what an earlier one broke may have nothing left to read."""
    try:
        return mutation(case) is not False
    except (ValueError, LookupError, TypeError, AttributeError, struct.error, zlib.error, state.NotShown, state.Broken):
        if len(case.done) > 1:
            return False
        raise


def of_program(path, folder, names):
    """The program itself, a process for each."""
    for name in names:
        command = [path, "evidence", "verify", f"{folder}/{name}.authros", "--trust", f"{folder}/{name}.toml", "--json"]
        done = subprocess.run(command, capture_output=True, env={"HOME": str(folder), "PATH": os.environ["PATH"]}, timeout=120)
        yield name, summary(json.loads(done.stdout), done.returncode)


def of_command(command, folder, names):
    cases = [{"bundle": f"{folder}/{name}.authros", "trust": f"{folder}/{name}.toml"} for name in names]
    done = subprocess.run(command.split(), input=json.dumps(cases).encode(), stdout=subprocess.PIPE, timeout=3600, check=True)
    return [(name, summary(one, None)) for name, one in zip(names, json.loads(done.stdout))]


def of_tools(folder, name):
    try:
        found = verify(f"{folder}/{name}.authros", f"{folder}/{name}.toml")
    except TrustError:
        return {"outcome": "no trust"}
    return summary(found.document(), found.exit_code)


def summary(document, code):
    """What verifiers are compared by: outcome, exporter, each level of each record with its reason, and each topic."""
    if code == 3 or "trust" in document:
        return {"outcome": "no trust"}
    if not document.get("exporter"):
        return {"outcome": "refused", "exporter": "nothing is read"}
    level = lambda one: " ".join(str(one[part]) for part in ("standing", "reason") if one.get(part))
    records = [[one["digest"], *(level(one[name]) for name in LEVELS), one.get("disclosed", None) and one["disclosed"]["message_sm3"]] for one in document["records"]]
    plain = lambda number: None if number is None else int(number)  # beyond 2^53 a text in JavaScript
    fields = ("topic_id", "signer", "standing")
    topics = [
        [*(one[name] for name in fields), *(plain(one[name]) for name in ("first", "last", "missing")), plain((one.get("heads") or {}).get("number"))]
        for one in document["complete"]
    ]
    return {"outcome": document["outcome"], "exporter": document["exporter"]["standing"], "records": records, "complete": topics,
            "verdict": document.get("verdict"), "code": code}


def difference(one, other):
    """What two summaries say differently, or None; a field that one has not is not compared."""
    if set(one) != set(other):
        return f"{one['outcome']} and {other['outcome']}: one of the two reads it"
    for name in one:
        mine, theirs = one[name], other[name]
        if mine == theirs or None in (mine, theirs):
            continue
        if isinstance(mine, list) and isinstance(theirs, list) and len(mine) == len(theirs):
            mine, theirs = next(pair for pair in zip(mine, theirs) if pair[0] != pair[1])
        return f"{name}: {mine} and {theirs}"
    return None


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bundle")
    parser.add_argument("trust")
    parser.add_argument("owner", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--verifier", action="append", default=[])
    parser.add_argument("--seed", default="1")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seconds", type=int)
    parser.add_argument("--only", type=int)
    given = parser.parse_args()
    all_ = bases(given.bundle, given.trust, given.owner.read_text(encoding="ascii"), random.Random(given.seed))
    verifiers = dict(one.split("=", 1) for one in given.verifier)
    begin, outcomes, done, apart, next_ = time.monotonic(), collections.Counter(), collections.Counter(), 0, given.only or 0
    while True:
        last = next_ + (1 if given.only is not None else AT_ONCE)
        cases = {f"{given.seed}-{number}": made(all_, given.seed, number) for number in range(next_, last)}
        for name, case in cases.items():
            (given.folder / f"{name}.authros").write_bytes(case.file())
            (given.folder / f"{name}.toml").write_bytes(case.trust.encode())
        told = {name: of_tools(given.folder, name) for name in cases}
        differing = {}
        for verifier, command in verifiers.items():
            path = command.partition("program:")[2]
            found = dict(of_program(path, given.folder, list(cases)) if path else of_command(command, given.folder, list(cases)))
            for name in cases:
                why = difference(told[name], found[name]) if name in found else "it says nothing"
                if why:
                    differing[name] = f"tools/verify and {verifier}: {why}"
        for name, case in cases.items():
            outcomes[told[name]["outcome"]] += 1
            done.update(case.done)
            if name in differing:
                apart += 1
                print(f"{name} ({', '.join(case.done)}): {differing[name]}", flush=True)
            else:
                for kind in ("authros", "toml"):
                    (given.folder / f"{name}.{kind}").unlink()
        next_ = last
        if given.only is not None or (time.monotonic() - begin > given.seconds if given.seconds else next_ >= given.count):
            break
    print(json.dumps({"cases": next_, "apart": apart, "outcomes": outcomes, "done": done}))
    # Nothing was compared where all come to one outcome.
    return 1 if apart or (given.only is None and len(outcomes) < 3) else 0


if __name__ == "__main__":
    sys.exit(main())
