#!/usr/bin/env python3
"""Counts lines of code: neither tests, nor blank lines, nor comments. `tests/count_lines.py [CHECKOUT]`.

A file that `#[cfg(test)] mod name;` names, and all below it, is a test; so is one that `#[path = ..]` beside it names, an
inline `#[cfg(test)] mod name { .. }`, and `tests/` of a crate. `labs/` and `tools/` are counted apart: they are not shipped.
"""

import re
import sys
from collections import Counter
from pathlib import Path

ATTRIBUTES = r"(?P<more>(?:\s*#\[[^\]]*\])*)\s*(?:pub(?:\([^)]*\))?\s+)?mod\s+(?P<name>\w+)\s*"
NAMED = re.compile(r"(?P<before>(?:#\[path\s*=[^\]]*\]\s*)?)#\[cfg\(test\)\]" + ATTRIBUTES + ";")
INLINE = re.compile(r"#\[cfg\(test\)\]" + ATTRIBUTES + r"\{")
PATH = re.compile(r'#\[path\s*=\s*"([^"]+)"\]')


def tests_of(file: Path, text: str) -> list[Path]:
    """Files and folders that hold this file's test modules, without `.rs`."""
    face = file.name in ("mod.rs", "lib.rs", "main.rs")
    folder = file.parent if face else file.with_suffix("")
    found = []
    for module in NAMED.finditer(text):
        path = PATH.search(module["before"] + module["more"])
        found.append((file.parent / path[1]).with_suffix("") if path else folder / module["name"])
    return found


def without_inline_tests(text: str) -> str:
    while found := INLINE.search(text):
        depth, place = 1, found.end()
        while depth and place < len(text):
            depth += {"{": 1, "}": -1}.get(text[place], 0)
            place += 1
        text = text[: found.start()] + text[place:]
    return text


def code_lines(text: str) -> int:
    text = re.sub(r"^\s*/\*.*?\*/", "", text, flags=re.S | re.M)
    lines = (line.strip() for line in text.splitlines())
    return sum(1 for line in lines if line and not line.startswith("//"))


def script_lines(text: str) -> int:
    lines = (line.strip() for line in text.splitlines())
    return sum(1 for line in lines if line and not line.startswith("#"))


def count(root: Path, folders: list[str]) -> Counter[str]:
    files = [file for folder in folders for file in sorted((root / folder).rglob("*.rs"))]
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    tests = {test for file, text in texts.items() for test in tests_of(file, text)}
    counts: Counter[str] = Counter()
    for file, text in texts.items():
        parts = file.relative_to(root).parts
        if "tests" in parts[:-1] or any(test == file.with_suffix("") or test in file.parents for test in tests):
            continue
        room = parts[1] if parts[0] == "crates" else "/".join(parts[: 2 if len(parts) > 2 else 1])
        counts[room] += code_lines(without_inline_tests(text))
    return counts


def show(title: str, counts: Counter[str]) -> None:
    for room, lines in sorted(counts.items(), key=lambda item: -item[1]):
        print(f"{lines:7} {room}")
    print(f"{sum(counts.values()):7} {title}\n")


def main() -> None:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    show("the product", count(root, ["src", "crates"]))
    show("labs, not shipped", count(root, ["labs"]))
    tools = {file.name: script_lines(file.read_text(encoding="utf-8")) for file in sorted((root / "tools").rglob("*.py"))}
    show("tools", Counter(tools))


if __name__ == "__main__":
    main()
