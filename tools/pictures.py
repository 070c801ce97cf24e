#!/usr/bin/env python3
"""Draws screens of the library (crates/console/src/term/library) as PNG files, with Python's standard library alone.

    tools/pictures.py                     the ten into docs/pictures
    tools/pictures.py NAME LOOK FILE      one of them, in one look: night, day, contrast, mono, sixteen, no-color, ascii

A screen is a snapshot `looks-NAME.snap`: its text, and for each look a letter for each cell with a legend of styles. The
letters are drawn with DejaVu Sans Mono (Debian: fonts-dejavu-core), lines, blocks and braille by themselves.
"""

import pathlib
import struct
import sys
import zlib

ROOT = pathlib.Path(__file__).resolve().parent.parent
LIBRARY = ROOT / "crates/console/src/term/library/snapshots"
PICTURES = ROOT / "docs/pictures"
FONTS = pathlib.Path("/usr/share/fonts/truetype/dejavu")

# What the manual shows, and in which look.
TEN = {
    "overview": "night",
    "topics": "night",
    "records-chosen-columns": "night",
    "provenance": "night",
    "record-plot": "night",
    "grant-asked": "contrast",
    "readers": "day",
    "in-trouble": "night",
    "quit-asked": "day",
    "incidents": "night",
}

# A terminal's own colours, paper and ink, for each look.
DARK, LIGHT = ((0x16, 0x19, 0x1F), (0xD8, 0xDC, 0xE2)), ((0xFB, 0xFB, 0xFA), (0x1B, 0x1F, 0x24))
GROUND = {"day": LIGHT, "mono": LIGHT, "no-color": LIGHT}
# The sixteen colours as xterm has them.
SIXTEEN = [(0, 0, 0), (205, 0, 0), (0, 205, 0), (205, 205, 0), (0, 0, 238), (205, 0, 205), (0, 205, 205), (229, 229, 229),
           (127, 127, 127), (255, 0, 0), (0, 255, 0), (255, 255, 0), (92, 92, 255), (255, 0, 255), (0, 255, 255),
           (255, 255, 255)]

EM, WIDE, HIGH, BASE, PAD = 20, 12, 24, 18, 10
FINE, SHADES = 4, 8


class Font:
    """The outlines of a TrueType font."""

    def __init__(self, path):
        data = self.data = path.read_bytes()
        count = struct.unpack(">H", data[4:6])[0]
        records = [struct.unpack(">4sLLL", data[12 + 16 * i:28 + 16 * i]) for i in range(count)]
        self.tables = {name.decode(): offset for name, _, offset, _ in records}
        self.units, self.long = self.number("head", 18, ">H"), self.number("head", 50, ">h")
        self.widths = self.number("hhea", 34, ">H")
        self.characters = self.map()

    def number(self, table, at, form):
        return struct.unpack_from(form, self.data, self.tables[table] + at)[0]

    def map(self):
        start, best = self.tables["cmap"], {}
        for index in range(self.number("cmap", 2, ">H")):
            at = start + struct.unpack_from(">L", self.data, start + 8 + 8 * index)[0]
            if struct.unpack_from(">H", self.data, at)[0] != 4:
                continue
            half = struct.unpack_from(">H", self.data, at + 6)[0]
            ends, starts = at + 14, at + 16 + half
            for segment in range(0, half, 2):
                end, begin = (struct.unpack_from(">H", self.data, place + segment)[0] for place in (ends, starts))
                delta, jump = (struct.unpack_from(">H", self.data, starts + (1 + i) * half + segment)[0] for i in (0, 1))
                for code in range(begin, min(end, 0xFFFE) + 1):
                    glyph = code
                    if jump:
                        glyph = struct.unpack_from(">H", self.data, starts + 2 * half + segment + jump + 2 * (code - begin))[0]
                    if glyph or not jump:
                        best[code] = (glyph + delta) & 0xFFFF
        return best

    def advance(self, glyph):
        return self.number("hmtx", 4 * min(glyph, self.widths - 1), ">H")

    def outline(self, glyph):
        """Its contours, each a list of points that are joined by straight lines."""
        size, form = (4, ">L") if self.long else (2, ">H")
        first, last = (self.number("loca", size * (glyph + i), form) * (1 if self.long else 2) for i in (0, 1))
        if first == last:
            return []
        at = self.tables["glyf"] + first
        contours = struct.unpack_from(">h", self.data, at)[0]
        return self.simple(at + 10, contours) if contours >= 0 else self.composed(at + 10)

    def composed(self, at):
        contours, more = [], True
        while more:
            flags, glyph = struct.unpack_from(">HH", self.data, at)
            right, up = struct.unpack_from(">hh" if flags & 1 else ">bb", self.data, at + 4)
            at += 8 if flags & 1 else 6
            scale = (1.0, 0.0, 0.0, 1.0)
            parts = 1 if flags & 8 else 2 if flags & 64 else 4 if flags & 128 else 0
            if parts:
                read = [value / 16384 for value in struct.unpack_from(f">{parts}h", self.data, at)]
                scale = {1: (read[0], 0, 0, read[0]), 2: (read[0], 0, 0, read[-1]), 4: tuple(read)}[parts]
                at += 2 * parts
            a, b, c, d = scale
            for contour in self.outline(glyph):
                contours.append([(a * x + c * y + right, b * x + d * y + up) for x, y in contour])
            more = flags & 32
        return contours

    def simple(self, at, count):
        ends = struct.unpack_from(f">{count}H", self.data, at)
        at += 2 * count
        at += 2 + struct.unpack_from(">H", self.data, at)[0]
        total, flags = (ends[-1] + 1 if ends else 0), []
        while len(flags) < total:
            flag, at = self.data[at], at + 1
            flags.append(flag)
            if flag & 8:
                flags += [flag] * self.data[at]
                at += 1
        axes = []
        for short, same in ((2, 16), (4, 32)):
            value, values = 0, []
            for flag in flags:
                if flag & short:
                    value += self.data[at] if flag & same else -self.data[at]
                    at += 1
                elif not flag & same:
                    value += struct.unpack_from(">h", self.data, at)[0]
                    at += 2
                values.append(value)
            axes.append(values)
        points = [(x, y, bool(flag & 1)) for x, y, flag in zip(*axes, flags)]
        begins = [0] + [end + 1 for end in ends]
        return [flattened(points[begin:end + 1]) for begin, end in zip(begins, ends)]


def flattened(points):
    """A contour of quadratic curves as straight pieces."""
    whole = []
    for index, (x, y, on) in enumerate(points):
        before = points[index - 1]
        if not on and not before[2]:
            whole.append(((x + before[0]) / 2, (y + before[1]) / 2, True))
        whole.append((x, y, on))
    first = next((index for index, point in enumerate(whole) if point[2]), 0)
    whole = whole[first:] + whole[:first + 1]
    line, index = [whole[0][:2]], 1
    while index < len(whole):
        x, y, on = whole[index]
        if on:
            line.append((x, y))
        else:
            (x0, y0), (x2, y2, _) = line[-1], whole[index + 1]
            for step in range(1, 7):
                t = step / 6
                u = 1 - t
                line.append((u * u * x0 + 2 * u * t * x + t * t * x2, u * u * y0 + 2 * u * t * y + t * t * y2))
            index += 1
        index += 1
    return line


def inked(contours, scale, left):
    """How much of each pixel of a cell lies inside the contours, 0 to 1."""
    ink = [[0.0] * WIDE for _ in range(HIGH)]
    for fine in range(HIGH * FINE):
        height = (BASE - (fine + 0.5) / FINE) / scale
        crossings = []
        for contour in contours:
            for (x0, y0), (x1, y1) in zip(contour, contour[1:] + contour[:1]):
                if (y0 <= height) != (y1 <= height):
                    across = x0 + (height - y0) * (x1 - x0) / (y1 - y0)
                    crossings.append((across * scale + left, 1 if y1 > y0 else -1))
        crossings.sort()
        winding = 0
        for (begin, turn), (end, _) in zip(crossings, crossings[1:]):
            winding += turn
            if winding:
                row = ink[fine // FINE]
                for x in range(max(0, int(begin)), min(WIDE, int(end) + 1)):
                    row[x] += max(0.0, min(end, x + 1) - max(begin, x)) / FINE
    return ink


def rectangle(ink, left, top, right, bottom):
    for y in range(HIGH):
        for x in range(WIDE):
            wide, high = min(right, x + 1) - max(left, x), min(bottom, y + 1) - max(top, y)
            if wide > 0 and high > 0:
                ink[y][x] = max(ink[y][x], wide * high)


# Lines of box drawing: whether they reach up, down, left, right.
BOX = {"─": "lr", "│": "ud", "┌": "dr", "┐": "dl", "└": "ur", "┘": "ul", "├": "udr", "┤": "udl", "┬": "dlr", "┴": "ulr",
       "┼": "udlr"}
BRAILLE = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3)]


def drawn(character):
    """A character that is a figure: lines, blocks and braille; None for all others."""
    ink, code = [[0.0] * WIDE for _ in range(HIGH)], ord(character)
    middle, centre, half = WIDE / 2, HIGH / 2, 1
    if character in BOX:
        for way in BOX[character]:
            left, right = (0 if way == "l" else middle - half), (WIDE if way == "r" else middle + half)
            top, bottom = (0 if way == "u" else centre - half), (HIGH if way == "d" else centre + half)
            rectangle(ink, left, top, right, bottom)
    elif 0x2581 <= code <= 0x2588:
        rectangle(ink, 0, HIGH * (1 - (code - 0x2580) / 8), WIDE, HIGH)
    elif 0x2589 <= code <= 0x258F:
        rectangle(ink, 0, 0, WIDE * (0x2590 - code) / 8, HIGH)
    elif character == "▀":
        rectangle(ink, 0, 0, WIDE, HIGH / 2)
    elif character == "▐":
        rectangle(ink, WIDE / 2, 0, WIDE, HIGH)
    elif 0x2800 <= code <= 0x28FF:
        for bit, (column, row) in enumerate(BRAILLE):
            if code - 0x2800 >> bit & 1:
                x, y = (column + 0.5) * WIDE / 2, (row + 0.5) * HIGH / 4
                rectangle(ink, x - 1.4, y - 1.4, x + 1.4, y + 1.4)
    else:
        return None
    return ink


class Pen:
    """The ink of characters, each computed once."""

    def __init__(self):
        self.fonts = {bold: [Font(FONTS / name) for name in names] for bold, names in
                      {False: ["DejaVuSansMono.ttf", "DejaVuSans.ttf"],
                       True: ["DejaVuSansMono-Bold.ttf", "DejaVuSans-Bold.ttf"]}.items()}
        self.known = {}

    def ink(self, character, bold):
        key = (character, bold)
        if key not in self.known:
            self.known[key] = drawn(character) or self.of_a_font(character, bold)
        return self.known[key]

    def of_a_font(self, character, bold):
        for font in self.fonts[bold]:
            glyph = font.characters.get(ord(character))
            if glyph:
                wide = font.advance(glyph)
                scale = min(EM / font.units, WIDE / wide)
                return inked(font.outline(glyph), scale, (WIDE - wide * scale) / 2)
        sys.exit(f"no font has U+{ord(character):04X}; install fonts-dejavu-core")


def read(name):
    """The sections of a snapshot: each title with its lines."""
    sections, lines = {}, None
    for line in (LIBRARY / f"looks-{name}.snap").read_text().splitlines():
        if line.startswith("== "):
            lines = sections.setdefault(line[3:], [])
        elif lines is not None:
            lines.append(line)
    return sections


def colour(text):
    if text.startswith("#"):
        return tuple(int(text[i:i + 2], 16) for i in (1, 3, 5))
    index = int(text)
    if index < 16:
        return SIXTEEN[index]
    if index >= 232:
        return (8 + 10 * (index - 232),) * 3
    step = [0, 95, 135, 175, 215, 255]
    return tuple(step[(index - 16) // by % 6] for by in (36, 6, 1))


def styled(words, paper, ink):
    """Paper, ink, bold and underlined of a style."""
    marks = dict(word.split("=", 1) if "=" in word else (word, "") for word in words.split())
    if "fg" in marks:
        ink = colour(marks["fg"])
    if "bg" in marks:
        paper = colour(marks["bg"])
    if "dim" in marks:
        ink = tuple((one + other) // 2 for one, other in zip(ink, paper))
    if "reversed" in marks:
        paper, ink = ink, paper
    return paper, ink, "bold" in marks, "underlined" in marks


def picture(name, look, pen):
    sections = read(name)
    text = sections.get(f"{look} text", sections["text"])
    own = GROUND.get(look, DARK)
    styles, grid = {" ": styled("", *own)}, []
    for line in sections[look]:
        if line.startswith("# "):
            styles[line[2]] = styled(line[4:], *own)
        else:
            grid.append(line)
    columns, rows = max(max(map(len, text)), 80), len(text)
    wide, high = columns * WIDE + 2 * PAD, rows * HIGH + 2 * PAD
    palette, image = {own[0]: 0}, [bytearray(wide) for _ in range(high)]
    for y, line in enumerate(text):
        letters = grid[y] if y < len(grid) else ""
        for x in range(columns):
            character = line[x] if x < len(line) else " "
            paper, ink, bold, underlined = styles[letters[x] if x < len(letters) else " "]
            cover = pen.ink(character, bold)
            for down in range(HIGH):
                row, begin = image[PAD + y * HIGH + down], PAD + x * WIDE
                for right in range(WIDE):
                    share = min(SHADES, round(cover[down][right] * SHADES))
                    if underlined and down == BASE + 2:
                        share = SHADES
                    mixed = tuple((p * (SHADES - share) + i * share) // SHADES for p, i in zip(paper, ink))
                    row[begin + right] = palette.setdefault(mixed, len(palette))
    if len(palette) > 256:
        sys.exit(f"{name}: {len(palette)} colours do not fit into a palette")
    return png(wide, high, palette, image)


def png(wide, high, palette, image):
    def chunk(kind, data):
        return struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))

    colours = b"".join(bytes(mixed) for mixed in palette)
    packed = zlib.compress(b"".join(b"\0" + bytes(row) for row in image), 9)
    head = struct.pack(">LLBBBBB", wide, high, 8, 3, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"PLTE", colours) + chunk(b"IDAT", packed)
            + chunk(b"IEND", b""))


def main(arguments):
    if not FONTS.is_dir():
        sys.exit(f"{FONTS} is missing; install fonts-dejavu-core")
    pen = Pen()
    if len(arguments) == 3:
        name, look, file = arguments
        pathlib.Path(file).write_bytes(picture(name, look, pen))
        return
    if arguments:
        sys.exit(__doc__)
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name, look in TEN.items():
        file = PICTURES / f"{name}.png"
        file.write_bytes(picture(name, look, pen))
        print(f"{file.relative_to(ROOT)}  {look}  {file.stat().st_size} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
