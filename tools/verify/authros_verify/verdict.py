"""The check of a bundle against its reader's pins, and what it comes to."""
import datetime
import os
import struct

from . import complete, facts, recorded, sentences
from .archive import LARGEST_ARCHIVE, unhex
from .bundle import Bundle
from .errors import Malformed
from .hashes import sm3
from .levels import LETTERS, Record
from .trust import Trust, read_trust

# How the program ends. What this Python could not check is a code of its own, for another one might.
HOLDS, REFUSED, INCOMPLETE, UNCHECKED = 0, 6, 8, 9


class Check:
    """A bundle and its pins: the chain is that of the pins, or else the bundle's own word."""

    def __init__(self, bundle, trust):
        self.bundle, self.trust = bundle, trust
        chain = bundle.manifest["chain"]
        id_, genesis = (trust.id, trust.genesis) if trust else (chain["id"], unhex(chain["genesis"]))
        self.contract = trust.contract if trust else unhex(chain["contract"])
        self.domain = sm3(b"AuthROS/domain/1" + struct.pack(">Q", id_) + genesis + self.contract)


class Verdict:
    """What a bundle comes to: `outcome` (holds, incomplete, refused), `exit_code`, `sentences`, and all details by `document()`."""

    def __init__(self, bundle, trust):
        self.bundle, self.trust, self.why, self.recording = bundle, trust, None, None
        check = Check(bundle, trust)
        self.all = [Record(check, digest) for digest in sorted(bundle.records)]
        self.stretches = complete.stretches(bundle, self.all)
        self.exporter = complete.exporter(check, self.all)
        self.outcome = "refused" if self.is_refused() else "holds" if self.is_whole() else "incomplete"
        self.sentences = sentences.verdict(facts.facts_of(self), facts.lists_of(self))

    @classmethod
    def malformed(cls, why):
        """Of a file that is no bundle."""
        found = cls.__new__(cls)
        found.bundle = found.trust = found.recording = None
        found.all, found.stretches, found.exporter, found.outcome, found.why = [], [], None, "refused", why
        found.sentences = [sentences.WORDING["sentences"][0]["say"][1][1], "Nothing in it counts: " + sentences.clean(why, 300) + "."]
        return found

    def standings(self):
        return [level.standing for one in self.all for _, level in one.levels()]

    def is_refused(self):
        parts = [self.exporter, *self.standings(), *(one.standing for one in self.stretches)]
        return "refused" in parts

    def needed(self):
        """(a) to (c) of all records; a statement of which something is merely not proven counts only if there is nothing else."""
        counted = [one for one in self.all if not one.is_mute()] or self.all
        return [standing for one in counted for standing in one.needed()]

    def is_proven(self):
        return bool(self.all) and set(self.needed()) == {"proven"}

    def is_self_sealed(self):
        return bool(self.all) and not self.is_proven() and set(self.needed()) <= {"proven", "own_chain"}

    def is_whole(self):
        return self.trust is not None and self.is_proven() and self.exporter == "proven" and "unchecked" not in self.standings()

    @property
    def exit_code(self):
        compared = self.recording["standing"] if self.recording else "proven"
        if "refused" in (self.outcome, compared):
            return REFUSED
        if "unchecked" in self.standings():
            return UNCHECKED
        return INCOMPLETE if self.outcome == "incomplete" or compared == "absent" else HOLDS

    def lines(self):
        """At most 25, as `authros evidence verify` prints them."""
        return [line for sentence in self.sentences for line in sentences.wrapped(sentence)]

    def document(self):
        """As `authros evidence verify --json` has it."""
        found = {"outcome": self.outcome, "verdict": self.sentences}
        if self.why is not None:
            return {**found, "why": self.why, "exporter": None, "records": [], "complete": []}
        found.update(pinned=self.trust is not None, exporter={"standing": self.exporter},
                     records=[record_document(one) for one in self.all], complete=[stretch_document(one) for one in self.stretches])
        return {**found, "recording": self.recording} if self.recording else found


def verify(path, trust=None, recording=None):
    """The verdict on a bundle, by a trust file or by what `read_trust` made of one; without it nothing about the chain is proven.

    `recording` is a recorded file to compare with what the bundle states of it. A trust file that cannot be used is a TrustError,
    a path that cannot be read an OSError; whatever is wrong with the bundle is in the verdict.
    """
    pins = trust if trust is None or isinstance(trust, Trust) else read_trust(trust)
    if os.path.exists(path) and not os.path.isfile(path):
        raise OSError(f"{path} is not a file")
    with open(path, "rb") as file:
        data = file.read(LARGEST_ARCHIVE + 1)
    try:
        found = Verdict(Bundle(data), pins)
    except Malformed as why:
        return Verdict.malformed(str(why))
    except Exception as why:  # a stranger's file: whatever it breaks, it is no evidence
        return Verdict.malformed(f"a member is not of its form ({type(why).__name__})")
    if recording is not None:
        found.recording = recorded.compared(recording, found.all)
    return found


def written(nanoseconds):
    """A time as JSON has it."""
    if nanoseconds is None:
        return None
    seconds, part = divmod(nanoseconds, 10 ** 9)
    try:
        text = datetime.datetime.fromtimestamp(seconds, datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return f"{nanoseconds} ns"
    return text + (f".{part:09}".rstrip("0") if part else "") + "Z"


def level_document(level):
    found = {"standing": level.standing}
    return {**found, "reason": level.reason} if level.reason else found


def record_document(one):
    found = {"digest": one.digest.hex()}
    if one.header is not None:
        at = one.anchored_at()
        found.update(owner=sentences.account(one.header.owner), signer=one.header.signer.hex(), recorder=one.header.recorder.hex(),
                     topic_id=one.header.topic.hex(), seq=one.header.seq, captured_at=written(one.header.time),
                     block=one.anchored.block if one.anchored else None, anchored_at=None if at is None else written(at * 10 ** 9),
                     existed_before=None if one.existed_before is None else written(one.existed_before * 10 ** 9))
    for name in LETTERS:
        found[name] = level_document(getattr(one, name))
    if one.head is not None:
        words = {name: sentences.clean(one.head[name], 256) for name in ("topic", "type", "publisher")}
        found["disclosed"] = {**words, "length": len(one.body), "message_sm3": sm3(one.body).hex()}
    return found


def stretch_document(one):
    heads = {"record": one.heads[0].digest.hex(), "number": one.heads[1]} if one.heads else None
    found = {"owner": sentences.account(one.owner), "signer": one.signer.hex(), "recorder": one.recorder.hex(), "topic_id": one.topic.hex(),
             "standing": one.standing, "first": one.first, "last": one.last, "gaps": [list(gap) for gap in one.gaps[:100]],
             "missing": one.missing, "uncounted": one.uncounted, "twice": one.twice, "heads": heads}
    return {**found, "reason": one.reason} if one.reason else found
