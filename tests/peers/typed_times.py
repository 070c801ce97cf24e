"""Expected values for crates/model/src/moment.rs, by datetime and zoneinfo alone.

    python3 tests/peers/typed_times.py > crates/model/src/moment/expected.tsv

Each line: time zone as POSIX writes it, now in ms, direction, text as typed, and the moment in ms, or `skipped`, or `twice`.
"""

import random
from datetime import date, datetime, time, timedelta, timezone
from zoneinfo import ZoneInfo

ZONES = {
    "UTC": "UTC0",
    "Asia/Shanghai": "CST-8",
    "Asia/Kathmandu": "<+0545>-5:45",
    "Europe/Berlin": "CET-1CEST,M3.5.0,M10.5.0/3",
    "America/New_York": "EST5EDT,M3.2.0,M11.1.0",
    "Australia/Lord_Howe": "<+1030>-10:30<+11>-11,M10.1.0,M4.1.0",
}
WEEKDAYS = ["Monday", "tuesday", "Wed", "thu", "friday", "SATURDAY", "sun"]
UNITS = {"ms": 1, "s": 1000, "m": 60_000, "h": 3_600_000, "d": 86_400_000, "w": 604_800_000}
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def milliseconds(moment):
    return (moment - EPOCH) // timedelta(milliseconds=1)


def instants(day, clock, zone):
    """All moments at which clocks there show this: none where they skip it, two where they show it twice."""
    found = set()
    for fold in (0, 1):
        there = datetime.combine(day, clock, zone).replace(fold=fold)
        utc = there.astimezone(timezone.utc)
        if utc.astimezone(zone).replace(tzinfo=None) == there.replace(tzinfo=None):
            found.add(utc)
    return sorted(found)


def shown(day, clock, zone):
    found = instants(day, clock, zone)
    return {0: "skipped", 2: "twice"}.get(len(found)) or milliseconds(found[0])


def roughly(day, clock, zone):
    """Where clocks skip it, as far after the gap as it is after its beginning; where they show it twice, the first."""
    found = instants(day, clock, zone)
    return found[0] if found else datetime.combine(day, clock, zone).astimezone(timezone.utc)


def chosen(day, step, clock, zone, now, ahead):
    at = roughly(day, clock, zone)
    if ahead and at <= now:
        return day + timedelta(days=step)
    if not ahead and at > now:
        return day - timedelta(days=step)
    return day


def clock_of(source):
    """A clock as typed, and as it is."""
    hour, minute, second, part = source.randrange(24), source.randrange(60), source.randrange(60), source.randrange(1000)
    # The hours at which clocks change.
    hour = source.choice([hour, hour, source.choice([1, 2, 3])])
    short = str(hour) if source.random() < 0.3 else f"{hour:02}"
    return source.choice([
        (f"{short}:{minute:02}", time(hour, minute)),
        (f"{short}:{minute:02}:{second:02}", time(hour, minute, second)),
        (f"{short}:{minute:02}:{second:02}.{part:03}", time(hour, minute, second, part * 1000)),
    ])


def case(source):
    name = source.choice(list(ZONES))
    zone, ahead = ZoneInfo(name), source.random() < 0.5
    # Days about the changes, and any others.
    around = source.choice([date(2026, 3, 29), date(2026, 10, 25), date(2026, 3, 8), date(2026, 11, 1), date(2026, 4, 5),
                            date(2026, 10, 4), date(2024, 2, 29), date(2027, 1, 1)])
    day = around + timedelta(days=source.choice([0, 0, -1, 1, source.randrange(-400, 400)]))
    now = datetime(day.year, day.month, day.day, tzinfo=timezone.utc) + timedelta(milliseconds=source.randrange(86_400_000))
    today = now.astimezone(zone).date()
    typed, clock = clock_of(source)
    kind = source.randrange(8)
    if kind == 0:
        unit, count = source.choice(list(UNITS)), source.randrange(1, 500)
        sign = source.choice(["", "-", "+"])
        forward = ahead if sign == "" else sign == "+"
        moved = count * UNITS[unit] * (1 if forward else -1)
        text, expected = f"{sign}{count}{unit}", milliseconds(now) + moved
    elif kind == 1:
        text, expected = typed, shown(chosen(today, 1, clock, zone, now, ahead), clock, zone)
    elif kind == 2:
        word, away = source.choice([("today", 0), ("yesterday", -1), ("tomorrow", 1), ("Tomorrow", 1)])
        text, expected = f"{word} {typed}", shown(today + timedelta(days=away), clock, zone)
    elif kind == 3:
        sign = source.choice([" ", "T", "  "])
        text, expected = f"{day}{sign}{typed}", shown(day, clock, zone)
    elif kind == 4:
        word = source.choice(WEEKDAYS)
        wanted = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"].index(word.lower()[:3])
        last = today - timedelta(days=(today.weekday() - wanted) % 7)
        text, expected = f"{word} {typed}", shown(chosen(last, 7, clock, zone, now, ahead), clock, zone)
    elif kind == 5:
        first = min(instants(day, time(0, 0), zone))
        text, expected = f"{day}", milliseconds(first)
    elif kind == 6:
        suffix, off = source.choice([("Z", 0), (" UTC", 0), ("+05:30", 330), ("-08:00", -480), (" +01:00", 60)])
        at = datetime.combine(day, clock, timezone(timedelta(minutes=off)))
        text, expected = f"{day} {typed}{suffix}", milliseconds(at)
    else:
        utc = datetime.combine(day, time(clock.hour, clock.minute, clock.second, clock.microsecond), timezone.utc)
        text, expected = utc.isoformat(timespec="milliseconds").replace("+00:00", "Z"), milliseconds(utc)
    return "\t".join([ZONES[name], str(milliseconds(now)), "ahead" if ahead else "back", text, str(expected)])


source = random.Random(45)
lines = [case(source) for _ in range(60_000)]
unusual = [line for line in lines if line.endswith(("skipped", "twice"))]
print("\n".join(unusual[:80] + lines[:420]))
