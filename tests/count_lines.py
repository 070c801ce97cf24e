#!/usr/bin/env python3
"""Counts the product's lines of Rust: neither tests, nor blank lines, nor comments. `tests/count_lines.py [CHECKOUT]`.

A file that `#[cfg(test)] mod name;` names, and all below it, is a test; so is an inline `#[cfg(test)] mod name { .. }`.
Fuzz targets and `tests/` are none of the product.
"""

import re
import sys
from collections import Counter
from pathlib import Path

NAMED = re.compile(r"#\[cfg\(test\)\](?:\s*#\[[^\]]*\])*\s*(?:pub(?:\([^)]*\))?\s+)?mod\s+(\w+)\s*;")
INLINE = re.compile(r"#\[cfg\(test\)\](?:\s*#\[[^\]]*\])*\s*(?:pub(?:\([^)]*\))?\s+)?mod\s+\w+\s*\{")


def tests_of(file: Path, text: str) -> list[Path]:
    """Files and folders that hold this file's test modules."""
    face = file.name in ("mod.rs", "lib.rs", "main.rs")
    folder = file.parent if face else file.with_suffix("")
    return [folder / name for name in NAMED.findall(text)]


def without_inline_tests(text: str) -> str:
    while found := INLINE.search(text):
        depth, place = 1, found.end()
        while depth and place < len(text):
            depth += {"{": 1, "}": -1}.get(text[place], 0)
            place += 1
        text = text[: found.start()] + text[place:]
    return text


def code_lines(text: str) -> int:
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
    lines = (line.strip() for line in text.splitlines())
    return sum(1 for line in lines if line and not line.startswith("//"))


def main() -> None:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    files = [file for folder in ("src", "crates", "benches") for file in sorted((root / folder).rglob("*.rs"))]
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    tests = {test for file, text in texts.items() for test in tests_of(file, text)}
    counts: Counter[str] = Counter()
    for file, text in texts.items():
        if any(test == file.with_suffix("") or test in file.parents for test in tests):
            continue
        parts = file.relative_to(root).parts
        room = parts[1] if parts[0] == "crates" else "/".join(parts[: 2 if len(parts) > 2 else 1])
        counts[room] += code_lines(without_inline_tests(text))
    for room, lines in sorted(counts.items(), key=lambda item: -item[1]):
        print(f"{lines:7} {room}")
    print(f"{sum(counts.values()):7} in all")


main()
