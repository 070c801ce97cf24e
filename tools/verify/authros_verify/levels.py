"""Levels (a) to (e) of one record (docs/format.md, section 11)."""
from . import record as records
from . import seals
from .curves import sm2_verify
from .errors import Refused, Unchecked, Unproven
from .hashes import sm3
from .packed import unpacked
from .stamps import check_token
from .state import Storage, number, rlp, shown

LETTERS = {"bytes": "a", "key": "b", "anchor": "c", "time": "d", "opened": "e"}
MOST_IDENTITIES = 16
OURS = b"AuthROS chain file version "


class Level:
    def __init__(self, standing, reason=None, text=""):
        self.standing, self.reason, self.text = standing, reason, text


def level_of(check, missing):
    """What a check comes to; anything else that it breaks is contradicted too, for the reason given."""
    try:
        return Level(check())
    except Unproven as why:
        return Level("unproven", why.reason, str(why))
    except Refused as why:
        return Level("refused", why.reason, str(why))
    except Unchecked as why:
        return Level("unchecked", "not_checked", str(why))
    except Exception as why:  # a stranger's file: whatever it breaks, it is no evidence
        return Level("refused", missing, f"malformed: {type(why).__name__}")


class Anchored:
    """What the state says of an anchor."""

    def __init__(self, storage, block, time, account, keys, shown_at):
        self.storage, self.block, self.time, self.account, self.keys, self.shown_at = storage, block, time, account, keys, shown_at


class Record:
    def __init__(self, check, digest):
        self.check, self.bundle, self.trust, self.digest = check, check.bundle, check.trust, digest
        parts = self.bundle.records[digest]
        self.record, self.signature, self.claim = parts["record.bin"], parts["signature.der"], parts.get("anchor.json")
        self.header = self.anchored = self.owner_key = self.head = self.body = self.existed_before = self.authority = None
        unjudged = Level("unproven")
        self.bytes, self.key, self.anchor, self.time = level_of(self.check_bytes, "not_a_record"), unjudged, unjudged, unjudged
        self.opened = Level("absent")
        if not self.is_intact():
            self.header = None
            return
        self.time = level_of(self.check_time, "bad_stamp")
        self.anchor = level_of(self.check_anchor, "state_broken")
        if self.anchored:
            self.key = self.capped(level_of(self.check_key, "registration_broken"))
        self.opened = self.capped(level_of(self.check_opened, "bad_disclosure"))

    def levels(self):
        return [(letter, getattr(self, name)) for name, letter in LETTERS.items()]

    def is_intact(self):
        return self.bytes.standing == "proven"

    def is_believed(self):
        return self.key.standing in ("proven", "own_chain")

    def is_statement(self):
        """Whether it opened as what a recorder states of itself; bundles add these to what was chosen."""
        return self.head is not None and self.head["topic"] == "authros/recorder" and self.head["type"] in ("authros/Birth", "authros/Heads")

    def needed(self):
        return [level.standing for level in (self.bytes, self.key, self.anchor)]

    def is_mute(self):
        """Of what a recorder states: it says nothing, and spoils nothing."""
        return self.is_statement() and {"unproven", "unchecked"} & set(self.needed()) and "refused" not in self.needed()

    def anchored_at(self):
        return self.anchored.time if self.anchored else None

    def capped(self, level):
        """A state is worth as much as the seals on it."""
        if level.standing == "proven":
            if self.anchor.standing == "own_chain":
                level.standing = "own_chain"
            elif self.anchor.standing != "proven":
                level.standing = "unproven"
        return level

    def check_bytes(self):  # (a)
        if sm3(self.record) != self.digest:
            raise Refused("not_as_filed")
        self.header = records.Header(self.record)
        self.header.expect_length(len(self.record))
        if self.header.domain != self.check.domain:
            raise Refused("other_chain")
        key = self.bundle.keys.get(self.header.signer)
        if key is None:
            raise Refused("signer_missing")
        if not sm2_verify(key, b"AuthROS/signature/1" + self.header.domain + self.digest, self.signature):
            raise Refused("bad_signature")
        return "proven"

    def check_anchor(self):  # (c)
        claim, owner = self.claim, self.header.owner
        if claim is None:
            raise Unproven("not_anchored")
        if not claim.leads(self.header.leaf(self.digest)):
            raise Refused("wrong_path")
        if claim.shown_at not in self.bundle.headers:
            raise Unproven("header_missing")
        header = rlp(self.bundle.headers[claim.shown_at])
        time, missing, broken = number(header[11]), "state_missing", "state_broken"
        find = lambda: Storage(self.bundle.nodes, header[3], self.check.contract)
        storage = self.bundle.once(("storage", claim.shown_at), lambda: shown(missing, broken, find))
        if self.trust and storage.code != self.trust.code_hash:
            raise Refused("other_code")
        if claim.is_batch:
            find = lambda: storage.anchor(claim.account, claim.root)
            block, count, at, keys = self.bundle.once(("anchor", claim.shown_at, claim.account, claim.root), lambda: shown(missing, broken, find))
            found = Anchored(storage, block, at or None, claim.account, keys, claim.shown_at)
        else:
            block, count = shown(missing, broken, lambda: storage.uploaded(owner, self.digest)), None
            found = Anchored(storage, block, time if block == claim.shown_at else None, owner, None, claim.shown_at)
        if not block:
            raise Refused("anchor_missing")
        if count != claim.count:
            raise Refused("other_anchor", "the state has another number of leaves")
        if block < claim.block and count == 1:
            raise Unproven("first_block_only")
        if block != claim.block or block > claim.shown_at or (found.time or 0) > time:
            raise Refused("other_anchor")
        self.anchored = found
        return self.bundle.once(("sealed", claim.shown_at), lambda: self.check_seals(header))

    def check_seals(self, header):
        if not self.trust:
            raise Unproven("no_trust")
        pinned = set(self.trust.signers)
        found = seals.seals(self.bundle.headers, number(header[8]), pinned)
        usual = max(1, seals.two_thirds(len(pinned))) if found.in_header else len(pinned) // 2 + 1
        if len(found.pinned) < (usual if self.trust.quorum is None else self.trust.quorum):
            if not pinned and not found.is_unsigned:
                raise Unproven("no_signers")
            if found.stranger and not found.pinned:
                raise Refused("other_signer")
            raise Unproven("no_seal" if found.is_unsigned else "few_signers")
        return "own_chain" if header[12].startswith(OURS) or self.trust.sealed_by_exporter else "proven"

    def check_key(self):  # (b)
        owner, at, storage = self.header.owner, self.anchored, self.anchored.storage
        see = lambda what, find: self.bundle.once((what, at.shown_at), lambda: shown("registration_missing", "registration_broken", find))
        keys_of = lambda version: see(("keys", owner, version), lambda: storage.keys(owner, version))
        version = at.keys if at.keys is not None and at.account == owner else self.claim.keys
        keys = keys_of(version)
        if keys is None:
            raise Unproven("no_keys")
        after = keys_of(version + 1)
        if keys[1] > at.block or (after and after[1] <= at.block):
            raise Unproven("keys_replaced")
        signing = self.bundle.identity(keys[0], owner, self.check.domain)
        if signing is None:
            raise Unproven("identity_missing")
        pinned = self.trust.key_of(owner) if self.trust else None
        if pinned is not None and pinned != sm3(b"\4" + signing):
            raise Unproven("other_key")
        self.owner_key = signing
        if sm3(b"\4" + signing) != self.header.signer:
            self.check_loan(*see(("loan", owner, self.header.signer), lambda: storage.loan(owner, self.header.signer)))
        is_suspended = see(("suspended", owner), lambda: storage.is_suspended(owner))
        if at.block == at.shown_at:
            if is_suspended:
                raise Refused("suspended")
        elif is_suspended or at.account != owner:
            # For the moment of its own anchor a later state is enough: the contract lets no suspended account anchor.
            raise Unproven("suspension_unknown")
        return "proven"

    def check_loan(self, until, begun, revoked):
        at = self.anchored
        if begun > at.block and at.shown_at > at.block:
            raise Unproven("device_unknown")
        if not begun or begun > at.block or 0 < revoked <= at.block:
            raise Refused("no_right")
        if until and at.time is None:
            raise Unproven("device_unknown")
        if until and at.time >= until:
            raise Refused("no_right")

    def check_time(self):  # (d)
        if self.claim is None or not self.claim.is_batch:
            return "absent"
        stamps = [one for one in self.bundle.stamps if self.claim.root in one.places]
        if not stamps:
            return "absent"
        if not self.claim.leads(self.header.leaf(self.digest)) or not all(one.leads(self.claim.root) for one in stamps):
            raise Refused("stamp_path")
        proven = None
        for stamp in stamps:
            for before, name in self.bundle.once(("stamp", stamp.imprint), lambda: self.tokens(stamp)):
                if name is not None and (proven is None or before < proven[0]):
                    proven = before, name
        if proven is None:
            raise Unproven("unknown_authority")
        self.existed_before, self.authority = proven
        return "proven"

    def tokens(self, stamp):
        """Of each token the second before which it existed, and the pinned authority's name or None."""
        authorities = self.trust.authorities if self.trust else []
        found = []
        for token in stamp.tokens:
            try:
                before, _, place = check_token(token, stamp.imprint, [certificate for _, certificate in authorities])
            except ValueError as why:
                raise Refused("bad_stamp", str(why)) from None
            found.append((before, None if place is None else authorities[place][0]))
        return found

    def check_opened(self):  # (e)
        secret = self.bundle.secrets.get(self.digest)
        if secret is None:
            return "absent"
        owner, domain = self.header.owner, self.check.domain
        signed = lambda key: key is not None and self.bundle.has_disclosed(key, domain, self.digest)
        pinned = self.trust.key_of(owner) if self.trust else None
        is_owners = signed(self.owner_key) or signed(self.bundle.keys.get(pinned))
        # Anybody can make an identity for somebody else's account: only the state or a pin says whose a key is.
        tried = sorted(self.bundle.identities)[:MOST_IDENTITIES]
        claims = lambda: any(signed(self.bundle.identity(hash_, owner, domain)) for hash_ in tried)
        if not is_owners and len(self.bundle.identities) <= MOST_IDENTITIES and not claims():
            raise Refused("foreign_disclosure")
        head, body = records.unsealed(self.record, self.header, secret)
        if head["plain_length"] > self.bundle.plain_left:
            raise Unproven("too_much_disclosed")
        self.bundle.plain_left -= head["plain_length"]
        body = unpacked(head["compression"], body, head["plain_length"])
        self.head, self.body = head, body
        if not is_owners:
            raise Unproven("unproven_disclosure")
        return "proven"
