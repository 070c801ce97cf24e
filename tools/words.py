#!/usr/bin/env python3
"""Lists what console, command line and site say, and holds docs/words-reviewed.md against the source.

    tools/words.py list      every string of more than one word in src/cli, crates/console and crates/service
    tools/words.py check     which strings of the list were changed again since
"""
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
PLACES = ("src/cli", "crates/console/src", "crates/service/src")
LITERAL = re.compile(r'"((?:[^"\\]|\\.)*)"', re.DOTALL)


def text_of(path):
    """The source of a file without its tests, with continued strings in one line."""
    text = path.read_text(encoding="utf-8").split("#[cfg(test)]\nmod tests {")[0]
    return re.sub(r"\\\n\s*", "", text)


def sources():
    for place in PLACES:
        for path in sorted((ROOT / place).rglob("*.rs")):
            if not any(part.startswith(("tests", "fixtures")) or part.endswith("_tests.rs") for part in path.parts):
                yield path.relative_to(ROOT), text_of(path)


def strings():
    """Place and text of each string that a person may read; help of the command line is in its doc comments."""
    for path, text in sources():
        for line in text.splitlines():
            said = line.strip()
            if said.startswith("///") and str(path).startswith("src/cli/args"):
                yield path, said.removeprefix("///").strip()
        for found in LITERAL.finditer("\n".join(line for line in text.splitlines() if not line.strip().startswith("//"))):
            if " " in found[1].strip():
                yield path, found[1].replace('\\"', '"')


def reviewed():
    """Place, old and new wording of each row of the list."""
    for line in (ROOT / "docs/words-reviewed.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 3 and cells[0].startswith(("src/", "crates/")):
            yield cells


def main():
    if sys.argv[1:] == ["list"]:
        for path, said in strings():
            print(f"{path}\t{said}")
        return 0
    if sys.argv[1:] != ["check"]:
        print(__doc__, file=sys.stderr)
        return 2
    everything = "\n".join(text for _, text in sources()).replace('\\"', '"')
    flat = " ".join(everything.split())
    rows = list(reviewed())
    gone = [row for row in rows if " ".join(row[2].split()) not in flat]
    print(f"{len(rows)} strings; {len(gone)} were changed again since")
    for row in gone:
        print("\t".join(row))
    return 0


if __name__ == "__main__":
    sys.exit(main())
