"""DER (X.690, 10 and 11), read strictly: definite and shortest lengths only, nothing left over."""
import collections
import datetime
import re

BOOLEAN, INTEGER, BITS, OCTETS, NULL, OBJECT, UTF8, UTC_TIME, GENERALIZED_TIME, SEQUENCE, SET = 1, 2, 3, 4, 5, 6, 12, 0x17, 0x18, 0x30, 0x31
LARGEST = 64 * 1024

Element = collections.namedtuple("Element", "tag content whole")


def context(number):
    return 0xA0 | number


def primitive(number):
    return 0x80 | number


class Der:
    """Takes elements one after the other; whatever is wrong is a ValueError."""

    def __init__(self, data):
        self.rest = data

    @classmethod
    def only(cls, data, tag):
        if len(data) > LARGEST:
            raise ValueError("it is too long")
        outer = cls(data)
        inner = outer.inside(tag)
        outer.end()
        return inner

    def next_tag(self):
        return self.rest[0] if self.rest else None

    def any(self):
        data = self.rest
        if len(data) < 2 or data[0] & 0x1F == 0x1F:
            raise ValueError("it ends too early, or has a tag of several bytes")
        size, begin = data[1], 2
        if size > 0x83 or size == 0x80:
            raise ValueError("a length is indefinite or too large")
        if size > 0x80:
            begin += size - 0x80
            size = int.from_bytes(data[2:begin], "big")
            if len(data) < begin or data[2] == 0 or size < 0x80:
                raise ValueError("a length is not in its shortest form")
        if begin + size > len(data):
            raise ValueError("it ends too early")
        self.rest = data[begin + size:]
        return Element(data[0], data[begin:begin + size], data[:begin + size])

    def element(self, tag):
        found = self.any()
        if found.tag != tag:
            raise ValueError("it has an element of the wrong type")
        return found

    def optional(self, tag):
        return self.any() if self.next_tag() == tag else None

    def inside(self, tag):
        return Der(self.element(tag).content)

    def inside_optional(self, tag):
        found = self.optional(tag)
        return None if found is None else Der(found.content)

    def integer(self):
        data = self.element(INTEGER).content
        if not data or (len(data) > 1 and (data[0], data[1] >> 7) in ((0, 0), (0xFF, 1))):
            raise ValueError("an integer is not in its shortest form")
        return data

    def small(self):
        return small(self.integer())

    def object(self):
        return self.element(OBJECT).content

    def bits(self):
        data = self.element(BITS).content
        if data[:1] != b"\0":
            raise ValueError("a bit string is not a whole number of bytes")
        return data[1:]

    def boolean(self):
        data = self.element(BOOLEAN).content
        if data not in (b"\0", b"\xff"):
            raise ValueError("a boolean is neither true nor false")
        return data == b"\xff"

    def end(self):
        if self.rest:
            raise ValueError("there is data left over")


def small(data):
    """A number from 0 to 2^32 - 1, in its shortest form."""
    if len(data) > 5 or data[:1] >= b"\x80":
        raise ValueError("an integer is too large or negative")
    return int.from_bytes(data, "big")


def seconds(element, up=False):
    """Seconds since 1970; a fraction is rounded up if `up` is set, otherwise down."""
    text = element.content.decode("ascii")
    form = {GENERALIZED_TIME: r"([0-9]{4})([0-9]{10})(\.[0-9]{0,8}[1-9])?Z", UTC_TIME: r"([0-9]{2})([0-9]{10})()Z"}.get(element.tag)
    found = re.fullmatch(form, text) if form else None
    if not found:
        raise ValueError("a time is not valid")
    year = int(found.group(1))
    if element.tag == UTC_TIME:  # RFC 5280, 4.1.2.5.1
        year += 2000 if year < 50 else 1900
    parts = [int(found.group(2)[at:at + 2]) for at in range(0, 10, 2)]
    moment = datetime.datetime(year, *parts, tzinfo=datetime.timezone.utc)
    since = (moment - datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)) // datetime.timedelta(seconds=1)
    if since < 0:
        raise ValueError("a time is not valid")
    return since + bool(up and found.group(3))
