"""The verdict in sentences, by the rules of sentences.json, which every verifier prints from (docs/format.md, section 12)."""
import datetime
import json
import pkgutil
import re

from .archive import checksummed

WORDING = json.loads(pkgutil.get_data(__package__, "sentences.json").decode())
# SHA-256 of the text that bundles have as VERIFY.txt.
READ_ME = pkgutil.get_data(__package__, "VERIFY.txt")
STANDINGS = ("proven", "own_chain", "unproven", "absent", "refused", "unchecked")
HIDDEN = re.compile("[\x00-\x1f\x7f-\x9f\xad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u2028-\u202e\u2060-\u206f\u3164"
                    "\ufe00-\ufe0f\ufeff\uffa0\ufff0-\ufffb\U00013430-\U0001343f\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e0fff]")
MARK = re.compile("[\u0300-\u036f\u0483-\u0489\u0591-\u05bd\u0610-\u061a\u064b-\u065f\u0e31\u0e34-\u0e3a\u0e47-\u0e4e\u1ab0-\u1aff\u1dc0-\u1dff\u20d0-\u20ff\ufe20-\ufe2f]")
MOST_MARKS = 4


def clean(text, width):
    """What a terminal may show of a stranger's text, cut to the given number of characters."""
    out, marks = [], 0
    for character in text:
        if len(out) == width:
            return "".join(out[:-1]) + "…"
        marks = marks + 1 if MARK.match(character) else 0
        out.append("\ufffd" if HIDDEN.match(character) or marks > MOST_MARKS else character)
    return "".join(out)


def short(text):
    return clean(text, WORDING["longest"])


def account(data):
    return "0x" + checksummed(data.hex())


def moment(seconds):
    return datetime.datetime.fromtimestamp(seconds, datetime.timezone.utc)


def time_of(seconds):
    """The last time that has 64 bits of nanoseconds stands for all later ones."""
    return moment(min(seconds, (2 ** 64 - 1) // 10 ** 9)).strftime("%Y-%m-%d %H:%M:%S UTC")


def span(times):
    """Of capture times, nanoseconds."""
    if not times:
        return ""
    first, last = moment(min(times) // 10 ** 9), moment(max(times) // 10 ** 9)
    if first == last:
        return time_of(min(times) // 10 ** 9)
    day = "" if first.date() == last.date() else last.strftime("%Y-%m-%d ")
    return f"{first:%Y-%m-%d %H:%M:%S} to {day}{last:%H:%M:%S} UTC"


def filled(text, *fields):
    def one(found):
        name, *words = found.group(1).split("|")
        value = next((some[name] for some in fields if name in some), "")
        if isinstance(value, str):
            return value
        number = f"{int(value):,}"
        return f"{number} {words[0] if value == 1 else words[1]}" if words else number

    return re.sub(r"\{([^{}]*)\}", one, text)


def said(sentence, facts, lists, most):
    def first(*fields):
        there = lambda name: next((bool(some[name]) for some in fields if name in some), False)
        for condition, text in sentence["say"]:
            if all(not there(word[1:]) if word[:1] == "!" else there(word) for word in condition.split()):
                return [filled(text, *fields)] if text else []
        return []

    if "each" not in sentence:
        return first(facts)
    items = lists[sentence["each"]]
    found = [text for item in items[:most] for text in first(item, facts)]
    left = items[most:]
    if left:
        found.append(filled(sentence["more"], {"groups": len(left), "count": sum(item.get("count", 0) for item in left)}, facts))
    return found


def wrapped(sentence):
    lines = []
    for word in sentence.split(" "):
        if lines and len(lines[-1]) + 1 + len(word) <= WORDING["width"]:
            lines[-1] += " " + word
        else:
            lines.append("  " + word if lines else word)
    return lines


def verdict(facts, lists):
    """All sentences; lists are shortened, what can be spared is left out, and at last sentences are shortened, until they fit the lines."""
    told = lambda most: [(one, text) for one in WORDING["sentences"] for text in said(one, facts, lists, most)]
    is_long = lambda found: sum(len(wrapped(text)) for _, text in found) > WORDING["lines"]
    most = WORDING["most"]
    found = told(most)
    while most > 0 and is_long(found):
        most -= 1
        found = told(most)
    spare = lambda: [place for place, (one, _) in enumerate(found) if one.get("spare")]
    while is_long(found) and spare():
        del found[spare()[-1]]
    if is_long(found):
        found = [(one, filled(one["short"], facts) if "short" in one else text) for one, text in found]
    return [text for _, text in found]
