"""What a forger of bundles can do: sign, seal and write states anew. From docs/format.md, with the hashes and curves of tools/verify."""
import base64
import hashlib
import json
import pathlib
import struct
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tools" / "verify"))

from authros_verify import bundle, seals, state  # noqa: E402
from authros_verify.archive import checksummed, packed  # noqa: E402
from authros_verify.ciphers import ghash, sm4, sm4_keys  # noqa: E402
from authros_verify.curves import SECP256K1, SM2, combined, der_numbers  # noqa: E402
from authros_verify.der import OCTETS, SEQUENCE, Der  # noqa: E402
from authros_verify.hashes import expand, keccak, sm3  # noqa: E402

UNLISTED = ("mimetype", "manifest.json", "manifest.der")


def number(data):
    return int.from_bytes(data, "big")


class SmKey:
    def __init__(self, draw, secret=None):
        self.draw, self.secret = draw, secret or draw.randrange(1, SM2.n - 1)
        x, y = combined(SM2, self.secret, 0, SM2.g)
        self.public = x.to_bytes(32, "big") + y.to_bytes(32, "big")
        self.id = sm3(b"\4" + self.public)

    @classmethod
    def of_pem(cls, draw, text):
        """From PKCS#8."""
        info = Der.only(base64.b64decode("".join(line for line in text.splitlines() if "-" not in line)), SEQUENCE)
        info.integer()
        info.element(SEQUENCE)
        key = Der.only(info.element(OCTETS).content, SEQUENCE)
        key.integer()
        return cls(draw, number(key.element(OCTETS).content))

    def sign(self, message):
        name = b"1234567812345678"
        constants = b"".join(one.to_bytes(32, "big") for one in (SM2.a, SM2.b, *SM2.g))
        e = number(sm3(sm3(struct.pack(">H", len(name) * 8) + name + constants + self.public) + message))
        k = self.draw.randrange(1, SM2.n)
        r = (e + combined(SM2, k, 0, SM2.g)[0]) % SM2.n
        s = pow(1 + self.secret, -1, SM2.n) * (k - r * self.secret) % SM2.n
        return bundle.der_of(r.to_bytes(32, "big") + s.to_bytes(32, "big"))

    def pem(self):
        info = bytes.fromhex("3059301306072a8648ce3d020106082a811ccf5501822d03420004") + self.public
        text = base64.b64encode(info)
        return b"\n".join([b"-----BEGIN PUBLIC KEY-----", text[:64], text[64:], b"-----END PUBLIC KEY-----"]) + b"\n"


class Account:
    def __init__(self, draw):
        self.draw, self.secret = draw, draw.randrange(1, SECP256K1.n)
        x, y = combined(SECP256K1, self.secret, 0, SECP256K1.g)
        self.address = keccak(x.to_bytes(32, "big") + y.to_bytes(32, "big"))[12:]

    def seal(self, hash_):
        k = self.draw.randrange(1, SECP256K1.n)
        x, y = combined(SECP256K1, k, 0, SECP256K1.g)
        s = pow(k, -1, SECP256K1.n) * (number(hash_) + x * self.secret) % SECP256K1.n
        parity = y & 1
        if s > SECP256K1.n // 2:
            s, parity = SECP256K1.n - s, parity ^ 1
        return x.to_bytes(32, "big") + s.to_bytes(32, "big") + bytes([parity])


def signed(members, key, account):
    """The members as this exporter would sign them; a manifest that is broken already is signed as it is."""
    members = {**members, f"keys/{key.id.hex()}.pem": key.pem()}
    text = members.get("manifest.json", b"")
    try:
        manifest = json.loads(text)
    except ValueError:
        return with_manifest(members, text, key)
    manifest["exporter"] = {"account": account, "key": key.id.hex()}
    return listed(members, manifest, key)


def listed(members, manifest, key):
    names = sorted(set(members) - set(UNLISTED))
    manifest["members"] = [
        {"name": name, "bytes": len(members[name]), "sm3": sm3(members[name]).hex(), "sha256": hashlib.sha256(members[name]).hexdigest()}
        for name in names
    ]
    return with_manifest(members, json.dumps(manifest).encode(), key)


def with_manifest(members, text, key):
    kind = bundle.KIND
    return {**members, "manifest.json": text, "manifest.der": key.sign(b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(text), text))}


def file_of(members):
    return packed(members)


def with_disclosures(members, secrets, key, domain):
    """The members with these secrets by digests, under one signature."""
    listed_ = b"".join(digest + secrets[digest] for digest in sorted(secrets))
    return {**members, "disclosed.bin": listed_, "disclosed.der": key.sign(b"AuthROS/reveal/2" + domain + listed_)}


def secrets_of(members):
    listed_ = members.get("disclosed.bin", b"")
    return {listed_[at:at + 32]: listed_[at + 32:at + 64] for at in range(0, len(listed_), 64)}


def extended(members, count):
    """The members with the given number of further headers after the last one."""
    last = max(int(name[6:-4]) for name in members if name.startswith("chain/") and name != "chain/nodes.rlp")
    header, members = state.rlp(members[f"chain/{last}.rlp"]), dict(members)
    for at in range(last + 1, last + 1 + count):
        header[8] = at.to_bytes((at.bit_length() + 7) // 8, "big")
        members[f"chain/{at}.rlp"] = state.encode(header)
    return members


def resealed(members, sealers, consensus):
    """The members with their headers sealed by these accounts: `clique` one after the other, `qbft` and `ibft` by all of them."""
    numbers = sorted(int(name[6:-4]) for name in members if name.startswith("chain/") and name != "chain/nodes.rlp")
    members, parent = dict(members), None
    for place, at in enumerate(numbers):
        header = state.rlp(members[f"chain/{at}.rlp"])
        if parent is not None and at - 1 in numbers:
            header[0] = parent
        if consensus == "clique":
            header[12], header[13] = bytes(32), bytes(32)
            header[12] += sealers[place % len(sealers)].seal(keccak(state.encode(header)))
            parent = keccak(state.encode(header))
        else:
            parent = commit(header, sealers, consensus == "ibft")
        members[f"chain/{at}.rlp"] = state.encode(header)
    return members


def commit(header, sealers, is_ibft, round_=0):
    """Puts the seals of all into a header; returns the block's hash."""
    header[13] = seals.MIX
    digits = round_.to_bytes(4, "big") if is_ibft else round_.to_bytes((round_.bit_length() + 7) // 8, "big")
    extra = [bytes(32), [one.address for one in sealers], b"" if is_ibft else [], digits]
    header[12] = state.encode(extra + ([] if is_ibft else [[]]))
    hash_ = keccak(state.encode(header))
    header[12] = state.encode(extra[:3] + ([] if is_ibft else [b"", []]))
    block = keccak(state.encode(header))
    header[12] = state.encode([*extra, [one.seal(hash_) for one in sealers]])
    return block


class State:
    """Nodes by their hashes, of which values can be replaced, and put where nothing was."""

    def __init__(self, members):
        self.nodes = {keccak(node): node for node in state.rlp(members["chain/nodes.rlp"])}

    def member(self):
        return state.encode([self.nodes[hash_] for hash_ in sorted(self.nodes)])

    def put(self, root, key, value):
        """The root of the trie with this value, or None where the nodes are not there."""
        try:
            found = self.below(root, state.nibbles(keccak(key)), value)
        except (KeyError, IndexError):
            return None
        return found if found is None or len(found) == 32 and isinstance(found, bytes) else self.kept(found)

    def kept(self, node):
        data = state.encode(node)
        if len(data) < 32:
            return node
        self.nodes[keccak(data)] = data
        return keccak(data)

    def below(self, at, path, value):
        node = state.rlp(self.nodes[at]) if isinstance(at, bytes) else at
        if len(node) == 17:
            child = node[path[0]]
            if child == b"":
                odd = len(path[1:]) % 2
                some = [2 + odd, *([] if odd else [0]), *path[1:]]
                new = self.kept([bytes(some[i] << 4 | some[i + 1] for i in range(0, len(some), 2)), value])
            else:
                new = self.below(child, path[1:], value)
            return None if new is None else self.kept(node[:path[0]] + [new] + node[path[0] + 1:])
        own = state.nibbles(node[0])
        own, is_leaf = own[2 - (own[0] & 1):], own[0] & 2
        if path[:len(own)] != own:
            return None
        new = value if is_leaf else self.below(node[1], path[len(own):], value)
        return None if new is None else self.kept([node[0], new])


def with_word(members, contract, at, slot, word):
    """The members with another word in the contract's storage after block `at`; its header is not sealed again. None if it cannot be."""
    states, header = State(members), state.rlp(members[f"chain/{at}.rlp"])
    found = state.look_up(states.nodes, header[3], contract)
    if found is None:
        return None
    account = state.rlp(found)
    storage = states.put(account[2], slot, state.encode(word.lstrip(b"\0")))
    if storage is None or not isinstance(storage, bytes):
        return None
    account[2] = storage
    root = states.put(header[3], contract, state.encode(account))
    if root is None:
        return None
    header[3] = root
    return {**members, "chain/nodes.rlp": states.member(), f"chain/{at}.rlp": state.encode(header)}


def gcm_seal(key, nonce, aad, plain):
    keys, pad = sm4_keys(key), lambda data: data + bytes(-len(data) % 16)
    stream = b"".join(sm4(keys, nonce + struct.pack(">I", n + 2)) for n in range(-(-len(plain) // 16)))
    text = bytes(a ^ b for a, b in zip(plain, stream))
    hashed = ghash(number(sm4(keys, bytes(16))), pad(aad) + pad(text) + struct.pack(">2Q", len(aad) * 8, len(text) * 8))
    return text + bytes(a ^ b for a, b in zip(sm4(keys, nonce + b"\0\0\0\1"), hashed))


def sealed_again(record, header, secret, key, head, body):
    """The record with this head and body, signed by another key: digest, record, signature, and its secret's commitment kept."""
    front = bytearray(record[:header.length])
    front[63:95] = key.id
    front[111:119] = key.id[:8]
    at = header.length - 76
    front[at + 8:at + 20] = struct.pack(">IQ", len(head) + 16, len(body) + 16)
    info = b"AuthROS/record/1" + header.domain + header.owner + bytes(front[103:119]) + header.epoch + header.number
    keys = expand(secret, info, 88)
    front[-32:] = keys[56:]
    front = bytes(front)
    data = front + gcm_seal(keys[28:44], keys[44:56], front, head) + gcm_seal(keys[:16], keys[16:28], front, body)
    return sm3(data), data, key.sign(b"AuthROS/signature/1" + header.domain + sm3(data))


def identity_of(key, envelope, owner, domain):
    token = bytes(31) + b"\5"
    proof = key.sign(b"AuthROS/identity/1" + domain + owner + key.public + envelope.public + token)
    r, s = (int(one).to_bytes(32, "big") for one in der_numbers(proof, 32))
    return token + key.public + envelope.public + r + s


def trust_of(chain, code_hash, signers, persons=(), authorities="", more=""):
    """A trust file."""
    spelled = lambda account: "0x" + checksummed(account.hex())
    text = f"[chain]\nid = {chain['id']}\ngenesis = \"{chain['genesis']}\"\ncontract = \"{chain['contract']}\"\ncode_hash = \"{code_hash}\"\n"
    text += f"signers = [{', '.join(json.dumps(spelled(one.address)) for one in signers)}]\nsealed_by_exporter = false\n{more}"
    for account, name, key in persons:
        text += f"\n[[person]]\naccount = \"{account}\"\nname = \"{name}\"\n" + (f"key = \"{key.hex()}\"\n" if key else "")
    return text + authorities

