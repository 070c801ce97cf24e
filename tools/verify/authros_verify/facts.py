"""What a verdict can speak of, by the names that sentences.json explains."""
from .sentences import READ_ME, STANDINGS, WORDING, account, filled, short, span, time_of

SUPPORTED = ("proven", "own_chain")
LATEST = (2 ** 63 - 1) // 10 ** 9


class Group:
    """How many records, and their capture times."""

    def __init__(self):
        self.count, self.times = 0, []

    def add(self, record):
        self.count += 1
        if record.header is not None:
            self.times.append(record.header.time)


def grouped(records, key):
    groups = {}
    for record in records:
        groups.setdefault(key(record), Group()).add(record)
    return groups


def anchored_at(record):
    """The anchor's time, if a person could read it."""
    at = record.anchored_at() if record.anchor.standing in SUPPORTED else None
    return at if at is not None and at <= LATEST else None


class Names:
    """What topics are called: by their own disclosed records, or by a label."""

    def __init__(self, records):
        self.known = {}
        for record in records:
            if record.head is not None:
                self.known.setdefault((record.header.signer, record.header.topic), record.head["topic"])

    def topic(self, signer, topic):
        name = self.known.get((signer, topic))
        return short(name) if name is not None else filled(WORDING["labels"]["sealed"], {"id": topic.hex()[:8]})

    def record(self, record):
        if record.header is None:
            return WORDING["labels"]["unreadable"]
        return WORDING["labels"]["recorder"] if record.is_statement() else self.topic(record.header.signer, record.header.topic)


def is_late(record):
    at = record.anchored_at()
    return at is not None and at < 2 ** 63 and at < record.header.time // 10 ** 9


def has_heads(stretch):
    return stretch.heads is not None and stretch.first is not None and stretch.heads[1] >= stretch.first


def later(stretch):
    """How many numbers the newest head names above the last one here."""
    return 0 if stretch.heads is None or stretch.last is None else max(0, stretch.heads[1] - stretch.last)


def is_counted(stretch):
    return stretch.standing in SUPPORTED and stretch.first is not None and not stretch.is_own_statements and not stretch.is_ring


def facts_of(result):
    records, trust, bundle = result.all, result.trust, result.bundle
    intact = [one for one in records if one.is_intact()]
    statements = [one for one in records if one.is_statement()]
    readable = [one for one in records if one.head is not None and not one.is_statement()]
    incomplete = result.outcome == "incomplete"
    counted = [one for one in result.stretches if is_counted(one)]
    own_chain = any(one.anchor.standing == "own_chain" for one in records)
    read_me = bundle.members.get("VERIFY.txt")
    return {
        "holds": result.outcome == "holds", "refused": result.outcome == "refused", "trust": trust is not None,
        "self_sealed": incomplete and result.is_self_sealed(),
        "unknown_exporter": incomplete and trust is not None and result.is_proven() and result.exporter != "proven",
        "records": len(records), "statements": len(statements), "intact": len(intact), "altered": len(records) - len(intact),
        "exporter": account(bundle.exporter), "exporter_person": short(trust.person(bundle.exporter)) if trust else "",
        "exporter_proven": result.exporter == "proven", "exporter_self_sealed": result.exporter == "own_chain",
        "exporter_refused": result.exporter == "refused",
        "undated": sum(one.existed_before is None and anchored_at(one) is None for one in records),
        "captured": span([one.header.time for one in intact if not one.is_statement()]),
        "readable_count": len(readable), "sealed": len(records) - len(readable) - len(statements),
        "complete": sum(has_heads(one) and not one.missing for one in counted),
        "gapless": sum(has_heads(one) and later(one) > 0 and one.missing == later(one) for one in counted),
        "unstated": sum(not has_heads(one) for one in counted),
        "rings": sum(one.is_ring and one.first is not None for one in result.stretches),
        "trust_denies": own_chain and trust is not None and not trust.sealed_by_exporter,
        "late_capture": any(is_late(one) for one in intact),
        "foreign_instructions": read_me is not None and read_me != READ_ME,
        "levels": levels(result), "worst": levels(result, False),
    }


def levels(result, counted=True):
    found = {}
    for record in result.all:
        for letter, level in record.levels():
            found.setdefault(letter, []).append(level.standing)
    if result.stretches:
        found["f"] = [one.standing for one in result.stretches]
    told = []
    for letter, standings in sorted(found.items()):
        if not counted:
            standings = ["refused"] if "refused" in standings else [max(standings, key=STANDINGS.index)]
        counts = [(standings.count(one), WORDING["standings"].get(one, WORDING["reasons"]["not_checked"])) for one in STANDINGS if one in standings]
        words = [word if len(counts) == 1 else f"{count:,} {word}" for count, word in counts]
        told.append(f"({letter}) {WORDING['levels'][letter]}: {', '.join(words)}")
    return "; ".join(told)


def lists_of(result):
    names = Names(result.all)
    readable = [one for one in result.all if one.head is not None and not one.is_statement()]
    return {
        "signed": signed(result), "stamped": stamped(result), "anchored": anchored(result),
        "readable": [
            {"topic": topic, "span": span(group.times), "count": group.count}
            for topic, group in sorted(grouped(readable, lambda one: short(one.head["topic"])).items(), key=by_count)
        ],
        "missing": numbered(names, result, lambda one: one.missing - later(one), lambda one: one.last),
        "later": numbered(names, result, later, lambda one: one.heads[1]),
        "doubts": doubts(names, result),
    }


def by_count(item):
    """The largest first, then by the bytes of its name."""
    key, group = item
    return -group.count, key.encode() if isinstance(key, str) else key


def signed(result):
    classes = {"proven": 0, "own_chain": 1}
    intact = [one for one in result.all if one.is_intact()]
    groups = grouped(intact, lambda one: (one.header.owner, classes.get(one.key.standing, 2)))
    found = []
    for (owner, kind), group in sorted(groups.items(), key=by_count):
        person = short(result.trust.person(owner)) if result.trust and kind < 2 else ""
        found.append({"account": account(owner), "person": person, "proven": kind == 0, "self_sealed": kind == 1, "count": group.count})
    return found


def stamped(result):
    groups = {}
    for record in result.all:
        if record.existed_before is not None:
            groups.setdefault(short(record.authority), []).append(record.existed_before)
    ordered = sorted(groups.items(), key=lambda item: (-len(item[1]), item[0].encode()))
    return [{"authority": name, "time": time_of(max(times)), "count": len(times)} for name, times in ordered]


def anchored(result):
    found = []
    for standing in SUPPORTED:
        times = [anchored_at(one) for one in result.all if one.anchor.standing == standing and anchored_at(one) is not None]
        if times:
            kind = {"proven": standing == "proven", "self_sealed": standing == "own_chain"}
            found.append({**kind, "time": time_of(max(times)), "count": len(times)})
    return found


def numbered(names, result, number, end):
    """The topics with such a number of numbers, the largest first."""
    those = [one for one in result.stretches if number(one) > 0]
    found = sorted((-number(one), names.topic(one.signer, one.topic).encode(), one.first, end(one)) for one in those)
    return [{"topic": topic.decode(), "from": first, "to": to, "count": -count} for count, topic, first, to in found]


def doubts(names, result):
    groups = {}
    for record in result.all:
        for letter, level in record.levels()[:None if record.is_intact() else 1]:
            if level.reason:
                key = level.standing != "refused", letter, names.record(record), level.reason
                groups.setdefault(key, Group()).add(record)
    for one in result.stretches:
        if one.reason:
            group = groups.setdefault((False, "f", names.topic(one.signer, one.topic), one.reason), Group())
            for record in one.records:
                group.add(record)
    order = lambda item: (*item[0][:2], -item[1].count, item[0][2].encode(), item[0][3])
    return [
        {"topic": topic, "span": span(group.times), "why": WORDING["reasons"][reason], "refused": not accepted, "count": group.count}
        for (accepted, _, topic, reason), group in sorted(groups.items(), key=order)
    ]
