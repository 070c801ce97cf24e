"""TOML 1.1 as far as a trust file has it: no numbers with fractions and no dates. Python's own reader came with 3.11."""
import re

BARE = re.compile(r"[A-Za-z0-9_-]+")
NUMBER = re.compile(r"0x[0-9A-Fa-f]+(?:_[0-9A-Fa-f]+)*|0o[0-7]+(?:_[0-7]+)*|0b[01]+(?:_[01]+)*|[+-]?(?:0|[1-9][0-9]*(?:_[0-9]+)*)")
ESCAPES = {"b": "\b", "t": "\t", "n": "\n", "f": "\f", "r": "\r", "e": "\x1b", '"': '"', "\\": "\\"}
DEEPEST = 64


class Table(dict):
    """Of a document: by a header, by a dotted key, or within a line."""

    how = "implied"


class Tables(list):
    """An array of tables, which further headers extend; other lists are whole."""


def wrong(text):
    return ValueError("the trust file is no TOML: " + text)


class Reader:
    def __init__(self, text):
        self.text, self.at = text.replace("\r\n", "\n"), 0
        if re.search("[\x00-\x08\x0b-\x1f\x7f]", self.text):
            raise wrong("it has a control character")

    def next(self, length=1):
        return self.text[self.at:self.at + length]

    def skip(self, literal):
        if not self.text.startswith(literal, self.at):
            return False
        self.at += len(literal)
        return True

    def expect(self, literal):
        if not self.skip(literal):
            raise wrong(f"{literal!r} is missing")

    def blank(self, lines=False):
        """White space; with `lines` also comments and line ends."""
        while self.at < len(self.text):
            if self.next() in (" ", "\t") or (lines and self.next() == "\n"):
                self.at += 1
            elif lines and self.next() == "#":
                self.comment()
            else:
                return

    def comment(self):
        end = self.text.find("\n", self.at)
        self.at = len(self.text) if end < 0 else end

    def line_end(self):
        self.blank()
        if self.next() == "#":
            self.comment()
        if self.at < len(self.text):
            self.expect("\n")

    def key(self):
        parts = []
        while True:
            self.blank()
            if self.next() in ('"', "'") and self.next():
                parts.append(self.string(False))
            else:
                found = BARE.match(self.text, self.at)
                if not found:
                    raise wrong("a key is missing")
                self.at = found.end()
                parts.append(found.group())
            self.blank()
            if not self.skip("."):
                return parts

    def string(self, may_have_lines=True):
        quote = self.next()
        if self.next(3) == quote * 3:
            if not may_have_lines:
                raise wrong("a key has several lines")
            return self.long_string(quote)
        self.at += 1
        out = []
        while not self.skip(quote):
            one = self.next()
            if one in ("", "\n"):
                raise wrong("a text does not end")
            self.at += 1
            out.append(self.escape() if one == "\\" and quote == '"' else one)
        return "".join(out)

    def long_string(self, quote):
        self.at += 3
        self.skip("\n")
        out = []
        while not self.skip(quote * 3):
            one = self.next()
            if not one:
                raise wrong("a text does not end")
            self.at += 1
            if one == "\\" and quote == '"':
                folded = re.compile(r"[ \t]*\n[ \t\n]*").match(self.text, self.at)
                if folded:
                    self.at, one = folded.end(), ""
                else:
                    one = self.escape()
            out.append(one)
        for _ in range(2):  # up to two quotes may stand before the three
            if self.skip(quote):
                out.append(quote)
        return "".join(out)

    def escape(self):
        one = self.next()
        self.at += 1
        if one in ESCAPES and one:
            return ESCAPES[one]
        length = {"x": 2, "u": 4, "U": 8}.get(one, 0)
        digits = self.next(length)
        if not length or not re.fullmatch("[0-9A-Fa-f]{%d}" % length, digits):
            raise wrong("an escape is unknown")
        self.at += length
        code = int(digits, 16)
        if code > 0x10FFFF or 0xD800 <= code < 0xE000:
            raise wrong("an escape is no character")
        return chr(code)

    def value(self, depth=0):
        if depth == DEEPEST:
            raise wrong("lists lie too deep")
        one = self.next()
        if one and one in "\"'":
            return self.string()
        if self.skip("["):
            return self.list(depth)
        if self.skip("{"):
            return self.inline(depth)
        for word, value in (("true", True), ("false", False)):
            if self.skip(word):
                return value
        found = NUMBER.match(self.text, self.at)
        after = self.text[found.end():found.end() + 1] if found else ""
        if not found or (after and after not in " \t\n,]}#"):
            raise wrong("a value is neither a text, a whole number, true nor false")
        self.at = found.end()
        digits = found.group().replace("_", "")
        number = int(digits, 0) if len(digits) < 70 else 2 ** 64
        if not -2 ** 63 <= number < 2 ** 63:
            raise wrong("a number is too large")
        return number

    def list(self, depth):
        found = []
        while True:
            self.blank(True)
            if self.skip("]"):
                return found
            found.append(self.value(depth + 1))
            self.blank(True)
            if not self.skip(","):
                self.expect("]")
                return found

    def inline(self, depth):
        found = Table()
        while True:
            self.blank(True)
            if self.skip("}"):
                break
            self.pair(found, depth + 1)
            self.blank(True)
            if not self.skip(","):
                self.expect("}")
                break
        seal(found)
        return found

    def pair(self, table, depth=0):
        *path, last = self.key()
        self.expect("=")
        self.blank()
        for part in path:
            table = table.setdefault(part, dotted())
            if not isinstance(table, Table) or table.how not in ("dotted", "open"):
                raise wrong(f"{part} is no table that a line can extend")
        if last in table:
            raise wrong(f"{last} is there twice")
        table[last] = self.value(depth)

    def header(self, document):
        """The table that a line in brackets begins."""
        is_list = self.skip("[")
        *path, last = self.key()
        self.expect("]]" if is_list else "]")
        self.line_end()
        at = document
        for part in path:
            at = at.setdefault(part, Table())
            at = at[-1] if isinstance(at, Tables) else at
            if not isinstance(at, Table) or at.how in ("whole", "dotted"):
                raise wrong(f"{part} is no table that a header can extend")
        if is_list:
            tables = at.setdefault(last, Tables())
            if not isinstance(tables, Tables):
                raise wrong(f"{last} is no list of tables")
            tables.append(Table())
            found = tables[-1]
        else:
            found = at.setdefault(last, Table())
            if not isinstance(found, Table) or found.how != "implied":
                raise wrong(f"{last} is there twice")
        found.how = "header"
        return found


def dotted():
    table = Table()
    table.how = "dotted"
    return table


def seal(table):
    """Of a table within a line nothing is added later."""
    table.how = "whole"
    for one in table.values():
        if isinstance(one, Table) and one.how == "dotted":
            seal(one)


def loads(text):
    reader, document = Reader(text), Table()
    table = document
    while True:
        reader.blank(True)
        if reader.at == len(reader.text):
            return document
        if reader.skip("["):
            table = reader.header(document)
            continue
        reader.pair(table)
        reader.line_end()
