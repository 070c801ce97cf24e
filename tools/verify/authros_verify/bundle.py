"""A bundle in its parts: each is within its bounds and of its form, or the bundle is refused (docs/format.md, section 11)."""
import base64
import hashlib
import re
import struct

from . import state
from .archive import ACCOUNT, LARGEST_ARCHIVE, format_of, json_of, unhex, unpacked
from .curves import der_numbers, is_sm2_point, sm2_verify
from .errors import Malformed
from .hashes import keccak, sm3

KIND = b"application/vnd.authros.evidence+zip"
SUITE = {"name": "SM/1", "signature": "SM2-SM3", "digest": "SM3", "cipher": "SM4-GCM", "kdf": "HKDF-SM3", "chain": "Keccak-256"}
FORMS = re.compile(r"mimetype|manifest\.(json|der)|trust\.toml|VERIFY\.txt|report\.html|heights\.json|disclosed\.(bin|der)|"
                   r"chain/(nodes|[0-9]+)\.rlp|stamps/[0-9a-f]{64}/(roots\.json|[0-9a-f]{32}\.der)|keys/[0-9a-f]{64}\.pem|"
                   r"identities/[0-9a-f]{64}\.bin|definitions/[0-9a-f]{64}\.txt|"
                   r"records/[0-9a-f]{64}/(record\.bin|signature\.der|anchor\.json)")
PLACE = {"root": 32, "index": int, "path": [32]}
# The lines of each JSON member: a number stands for hex of that many bytes, a tuple for one form or another.
MANIFEST = {"format": str, "suite": {name: str for name in SUITE}, "chain": {"id": int, "genesis": 32, "contract": ACCOUNT},
            "exporter": {"account": ACCOUNT, "key": 32}, "members": [{"name": str, "bytes": int, "sm3": 32, "sha256": 32}]}
HEIGHTS = {"format": str, "heights": [{"heads": 32, "topic": 16, "number": int, "index": int, "path": [32]}]}
ANCHOR = {"format": str, "block": int, "shown_at": int, "keys": int,
          "anchor": ({"mode": str}, {"mode": str, "account": ACCOUNT, "root": 32, "index": int, "count": int, "path": [32]})}
STAMP = {"format": str, "top": 32, "count": int, "roots": [PLACE]}

MOST_RECORDS = 10_000
MOST_LEAVES, LONGEST_PATH = 16_384, 14
MOST_TOKENS = 4
LONGEST_HEADER = 8192
LONGEST_REPORT = 16 * 2 ** 20
LONGEST_RECORD = 64 * 2 ** 20 + 16 + 64 * 1024 + 1024
MOST_PLAIN = 256 * 2 ** 20


def longest(name):
    if name in ("manifest.json", "heights.json", "chain/nodes.rlp", "disclosed.bin") or name.endswith("/roots.json"):
        return LARGEST_ARCHIVE
    return LONGEST_RECORD if name.endswith("/record.bin") else LONGEST_REPORT if name == "report.html" else 65_536


def root_of(leaf, index, count, path):
    """RFC 9162, 2.1.3.2; None where the path has not the length of that place."""
    if not index < count or len(path) > LONGEST_PATH:
        return None
    place, last, h = index, count - 1, leaf
    for p in path:
        if last == 0:
            return None
        if place & 1 or place == last:
            h = sm3(b"\1" + p + h)
            while place & 1 == 0 and place:
                place, last = place >> 1, last >> 1
        else:
            h = sm3(b"\1" + h + p)
        place, last = place >> 1, last >> 1
    return h if last == 0 else None


def signature_of_form(data, name):
    try:
        der_numbers(data, 32)
    except ValueError:
        raise Malformed(name + " is no SM2 signature") from None
    return data


class Anchor:
    """What anchor.json claims."""

    def __init__(self, data, name):
        claim = json_of(data, ANCHOR, name)
        how = claim["anchor"]
        self.is_batch = len(how) > 1
        if claim["format"] != "authros-anchor/1" or how["mode"] != ("batch" if self.is_batch else "each"):
            raise Malformed(name + " is not of its form")
        self.block, self.shown_at, self.keys = claim["block"], claim["shown_at"], claim["keys"]
        self.count = None
        if self.is_batch:
            self.account, self.root, self.path = unhex(how["account"]), unhex(how["root"]), [unhex(step) for step in how["path"]]
            self.index, self.count = how["index"], how["count"]
            if len(self.path) > LONGEST_PATH:
                raise Malformed(name + " has a path longer than in any batch")

    def leads(self, leaf):
        return not self.is_batch or root_of(leaf, self.index, self.count, self.path) == self.root


class Stamp:
    """Roots of batches with their paths to what was stamped, and the tokens over it."""

    def __init__(self, imprint, listed, tokens, name):
        self.imprint, self.count, self.top, self.tokens = imprint, listed["count"], unhex(listed["top"]), tokens
        roots = [unhex(one["root"]) for one in listed["roots"]]
        named = hashlib.sha256(b"AuthROS/stamp/1" + self.top + struct.pack(">Q", self.count)).digest() == imprint
        if listed["format"] != "authros-stamp/1" or not named or max(self.count, len(roots)) > MOST_LEAVES:
            raise Malformed(name + " is not of its form")
        if any(one >= next_ for one, next_ in zip(roots, roots[1:])) or any(len(one["path"]) > LONGEST_PATH for one in listed["roots"]):
            raise Malformed(name + " has its roots in another order, or a path longer than in any stamp")
        self.places = {root: (one["index"], [unhex(step) for step in one["path"]]) for root, one in zip(roots, listed["roots"])}

    def leads(self, root):
        index, path = self.places[root]
        return root_of(sm3(b"\0AuthROS/stamp/1" + root), index, self.count, path) == self.top


class Bundle:
    def __init__(self, data):
        if len(data) > LARGEST_ARCHIVE:
            raise Malformed("it is longer than any bundle can be")
        self.members, self.plain_left, self.known = unpacked(data), MOST_PLAIN, {}
        for name, content in self.members.items():
            if not FORMS.fullmatch(name) or len(content) > longest(name):
                raise Malformed(f"{name[:120]} does not belong in a bundle, or is too long")
        if self.members.get("mimetype") != KIND:
            raise Malformed("it does not say that it is an evidence bundle")
        self.read_manifest()
        self.keys = {bytes.fromhex(name[5:69]): self.pem(name, content) for name, content in self.below("keys/")}
        self.identities = {keccak(content): content for _, content in self.below("identities/")}
        for name, content in self.below("identities/"):
            if keccak(content).hex() != name[11:75] or len(content) != 224:
                raise Malformed(name + " is malformed, or filed under another's name")
        for name, content in self.below("definitions/"):
            if sm3(content).hex() != name[12:76]:
                raise Malformed(name + " is filed under another's name")
            content.decode()
        self.members.get("trust.toml", b"").decode()
        self.headers = {}
        for name, content in self.below("chain/"):
            if name == "chain/nodes.rlp":
                continue
            self.headers[self.header(name, content)] = content
        self.nodes = state.nodes_of(self.members["chain/nodes.rlp"]) if "chain/nodes.rlp" in self.members else {}
        self.heights = self.read_heights()
        self.stamps = self.read_stamps()
        self.records = self.read_records()
        self.secrets = self.read_disclosures()
        self.is_signed = self.has_signature()

    def below(self, folder):
        return [(name, content) for name, content in sorted(self.members.items()) if name.startswith(folder)]

    def read_manifest(self):
        if "manifest.json" not in self.members:
            raise Malformed("manifest.json is missing")
        # Before the form, which a later version may have changed.
        if format_of(self.members["manifest.json"]) not in (None, "authros-evidence/1"):
            raise Malformed("manifest.json has another format than authros-evidence/1; use a newer authros-verify")
        self.manifest = json_of(self.members["manifest.json"], MANIFEST, "manifest.json")
        if self.manifest["format"] != "authros-evidence/1" or self.manifest["suite"] != SUITE:
            raise Malformed("manifest.json has another format, or names other algorithms")
        listed = {name for name in self.members if name not in ("mimetype", "manifest.json", "manifest.der")}
        if [member["name"] for member in self.manifest["members"]] != sorted(listed):
            raise Malformed("the manifest does not name the members")
        for member in self.manifest["members"]:
            data = self.members[member["name"]]
            found = len(data), sm3(data), hashlib.sha256(data).digest()
            if found != (member["bytes"], unhex(member["sm3"]), unhex(member["sha256"])):
                raise Malformed(member["name"] + " does not match the manifest")
        self.exporter = unhex(self.manifest["exporter"]["account"])
        self.exporter_key = unhex(self.manifest["exporter"]["key"])

    def has_signature(self):
        key, text = self.keys.get(self.exporter_key), self.members["manifest.json"]
        signed = b"DSSEv1 %d %s %d %s" % (len(KIND), KIND, len(text), text)
        return key is not None and sm2_verify(key, signed, self.members.get("manifest.der", b""))

    @staticmethod
    def pem(name, data):
        """SubjectPublicKeyInfo of SM2's curve; its last 64 bytes are the point."""
        try:
            info = base64.b64decode(b"".join(line for line in data.split(b"\n") if b"-" not in line))
        except ValueError:
            raise Malformed(name + " is not an SM2 public key") from None
        text = base64.b64encode(info)
        lines = [b"-----BEGIN PUBLIC KEY-----", text[:64], text[64:], b"-----END PUBLIC KEY-----"]
        is_key = info[:-64] == bytes.fromhex("3059301306072a8648ce3d020106082a811ccf5501822d03420004")
        if not is_key or data != b"\n".join(lines) + b"\n" or not is_sm2_point(info[-64:]):
            raise Malformed(name + " is not an SM2 public key in its one form")
        if sm3(b"\4" + info[-64:]).hex() != name[5:69]:
            raise Malformed(name + " is filed under another key's name")
        return info[-64:]

    @staticmethod
    def header(name, data):
        """The number of a block, under which its header is filed."""
        found = state.rlp(data)
        if len(data) > LONGEST_HEADER or not isinstance(found, list) or not 15 <= len(found) <= 32:
            raise Malformed(name + " is malformed, or longer than any header")
        texts = all(isinstance(found[at], bytes) for at in (0, 3, 12, 13)) and len(found[0]) == len(found[3]) == 32
        state.number(found[11])
        if not texts or f"chain/{state.number(found[8])}.rlp" != name:
            raise Malformed(name + " is malformed, or filed under another block's number")
        return state.number(found[8])

    def read_heights(self):
        """Heads, topics, highest numbers and paths, as the exporter lists them."""
        if "heights.json" not in self.members:
            return []
        listed = json_of(self.members["heights.json"], HEIGHTS, "heights.json")
        if listed["format"] != "authros-heights/1" or len(listed["heights"]) > MOST_RECORDS:
            raise Malformed("heights.json has another format, or too many entries")
        found = []
        for one in listed["heights"]:
            path = [unhex(step) for step in one["path"]]
            if len(path) > LONGEST_PATH:
                raise Malformed("heights.json has a path longer than in any head")
            found.append((unhex(one["heads"]), unhex(one["topic"]), one["number"], one["index"], path))
        return found

    def read_stamps(self):
        folders = {}
        for name, content in self.below("stamps/"):
            _, imprint, part = name.split("/")
            folders.setdefault(imprint, {})[part] = content
            if part != "roots.json" and hashlib.sha256(content).hexdigest()[:32] != part[:-4]:
                raise Malformed(name + " is not a token named by its SHA-256")
        if len(folders) > MOST_RECORDS:
            raise Malformed("it has too many time stamps")
        found = []
        for imprint, parts in sorted(folders.items()):
            name = f"stamps/{imprint}/roots.json"
            roots = parts.pop("roots.json", None)
            if roots is None or not 1 <= len(parts) <= MOST_TOKENS:
                raise Malformed(f"stamps/{imprint} has no roots, no token, or too many tokens")
            found.append(Stamp(bytes.fromhex(imprint), json_of(roots, STAMP, name), [parts[part] for part in sorted(parts)], name))
        return found

    def read_records(self):
        """By digest: record, signature, and anchor or None."""
        found = {}
        for name, content in self.below("records/"):
            _, digest, part = name.split("/")
            found.setdefault(bytes.fromhex(digest), {})[part] = content
        if len(found) > MOST_RECORDS:
            raise Malformed("it has too many records")
        for digest, parts in found.items():
            name = f"records/{digest.hex()}/"
            if "record.bin" not in parts or "signature.der" not in parts:
                raise Malformed(name + " has no record, or no signature")
            signature_of_form(parts["signature.der"], name + "signature.der")
            if "anchor.json" in parts:
                parts["anchor.json"] = Anchor(parts["anchor.json"], name + "anchor.json")
        return found

    def read_disclosures(self):
        """Secrets by digests; one signature is over all of them."""
        listed, self.disclosure = self.members.get("disclosed.bin"), self.members.get("disclosed.der")
        if listed is None and self.disclosure is None:
            return {}
        if listed is None or self.disclosure is None:
            raise Malformed("disclosed.bin or disclosed.der is missing")
        signature_of_form(self.disclosure, "disclosed.der")
        entries = [(listed[at:at + 32], listed[at + 32:at + 64]) for at in range(0, len(listed), 64)]
        digests = [digest for digest, _ in entries]
        if not listed or len(listed) % 64 or len(entries) > MOST_RECORDS or digests != sorted(set(digests)):
            raise Malformed("disclosed.bin is not a list of digests and secrets, ascending")
        if not set(digests) <= set(self.records):
            raise Malformed("disclosed.bin discloses a record that is not in the bundle")
        return dict(entries)

    def has_disclosed(self, key, domain, digest):
        """Whether this key signed the disclosure of this record."""
        signed = b"AuthROS/reveal/3" + domain + self.once("list", lambda: sm3(self.members["disclosed.bin"]))
        return self.once(("disclosed", key), lambda: sm2_verify(key, signed, self.disclosure))

    def once(self, what, find):
        """What many records ask for is found out once, and so are its errors."""
        if what not in self.known:
            try:
                self.known[what] = find(), None
            except Exception as why:
                self.known[what] = None, why
        found, why = self.known[what]
        if why is not None:
            raise why
        return found

    def identity(self, hash_, owner, domain):
        """P_C of an identity that proves itself for this account, or None."""
        return self.once(("identity", hash_, owner), lambda: self.proven_identity(hash_, owner, domain))

    def proven_identity(self, hash_, owner, domain):
        data = self.identities.get(hash_)
        if data is None:
            return None
        token, signing, envelope, proof = data[:32], data[32:96], data[96:160], data[160:]
        message = b"AuthROS/identity/1" + domain + owner + signing + envelope + token
        is_whole = signing != envelope and is_sm2_point(envelope)
        return signing if is_whole and sm2_verify(signing, message, der_of(proof)) else None


def der_of(raw):
    number = lambda b: bytes([2, len(b)]) + b
    short = lambda b: (lambda s: b"\0" + s if not s or s[0] & 0x80 else s)(b.lstrip(b"\0"))
    body = number(short(raw[:32])) + number(short(raw[32:]))
    return bytes([0x30, len(body)]) + body
