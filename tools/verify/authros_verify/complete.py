"""Level (f): which numbers of a topic are there, and up to which its recorder said that there were any. And who put the bundle together."""
from .bundle import root_of
from .hashes import sm3

LABEL, TOPIC, HEADS = b"AuthROS/heads/1", "authros/recorder", "authros/Heads"


class Stretch:
    """The records of one topic by one key in one recorder."""

    def __init__(self, of, records, claims):
        self.owner, self.signer, self.recorder, self.topic = of
        numbered = {}
        for one in records:
            numbered.setdefault(one.header.seq, []).append(one)
        believed = [one for one in records if one.is_believed()]
        numbers = sorted({one.header.seq for one in believed})
        self.records, self.uncounted = records, len(records) - len(believed)
        self.twice = sorted(seq for seq, ones in numbered.items() if len(ones) > 1 and any(one.is_believed() for one in ones))
        self.first, self.last = (numbers[0], numbers[-1]) if numbers else (None, None)
        named = [number for _, number in claims]
        is_false = None in named or any(after < before for before, after in zip(named, named[1:]))
        self.reason = "two_histories" if self.twice else "false_heads" if is_false else None
        of_heads = [head for head, _ in claims[-1:]]
        is_own = any(one.key.standing == "own_chain" for one in [*records, *of_heads])
        self.standing = "refused" if self.reason else "unproven" if not numbers else "own_chain" if is_own else "proven"
        self.is_own_statements = bool(believed) and all(one.is_statement() for one in believed)
        self.is_ring = self.recorder[0] == 2
        # The head, and the number that it names.
        self.heads = claims[-1] if claims and claims[-1][1] is not None else None
        self.missing = self.last - self.first + 1 - len(numbers) if numbers else 0
        if numbers and self.heads:
            self.missing += max(0, self.heads[1] - self.last)
        self.gaps = [(one + 1, after - 1) for one, after in zip(numbers, numbers[1:]) if after > one + 1]
        if numbers and self.heads and self.heads[1] > self.last:
            self.gaps.append((self.last + 1, self.heads[1]))
        if self.is_own_statements or self.is_ring:
            # Nobody claims that these are all: they are there for others, or most fell out of the ring.
            self.missing, self.gaps, self.heads = 0, [], None


def stretches(bundle, records):
    topics, found = {}, []
    for one in records:
        if one.is_intact():
            header = one.header
            topics.setdefault((header.owner, header.signer, header.recorder, header.topic), []).append(one)
    heads = {one.digest: one for one in records if is_head(one)}
    for of, ones in sorted(topics.items()):
        claims = []
        for digest, topic, number, index, path in bundle.heights:
            head = heads.get(digest)
            if topic != of[3] or head is None or (head.header.owner, head.header.signer, head.header.recorder) != of[:3]:
                continue
            leaf = sm3(b"\0AuthROS/height/1" + topic + number.to_bytes(8, "big"))
            leads = root_of(leaf, index, int.from_bytes(head.body[15:19], "big"), path) == head.body[19:51]
            claims.append((head, number if leads else None))
        claims.sort(key=lambda claim: claim[0].header.seq)
        found.append(Stretch(of, ones, claims))
    return found


def is_head(one):
    """A head that counts: its (b) is proven, and its message opened under these two names."""
    is_named = one.is_believed() and one.head is not None and (one.head["topic"], one.head["type"]) == (TOPIC, HEADS)
    return is_named and len(one.body) == 115 and one.body[:15] == LABEL


def exporter(check, records):
    """Whether the exporter owns the bundle's records, or is pinned."""
    bundle, account = check.bundle, check.bundle.exporter
    if not bundle.is_signed:
        return "refused"
    pinned = check.trust.key_of(account) if check.trust else None
    if pinned is not None:
        return "proven" if pinned == bundle.exporter_key else "unproven"
    whole = [one for one in records if one.is_intact()]
    if not all(one.header.owner == account for one in whole):
        return "unproven"
    tied = {one.anchor.standing for one in whole if one.owner_key and sm3(b"\4" + one.owner_key) == bundle.exporter_key}
    return "proven" if "proven" in tied else "own_chain" if "own_chain" in tied else "unproven"
