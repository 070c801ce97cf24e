#!/usr/bin/env python3
"""Looks for the phrases of `tests/words.txt` in what people read: messages, help, screens and pages. `tests/words.py [CHECKOUT]`.

Messages are the literals of two words or more in product code, help is the doc comments of `src/cli`. Names of commands are not
judged: what stands between backticks, or is a line of a code block, is left out. Ends with 1 if there is a hit.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from count_lines import tests_of, without_inline_tests

LITERAL = re.compile(
    r"""(?P<help>^[ ]*///[^\n]*) | //[^\n]* | /\*.*?\*/
    | b?r(?P<hashes>\#*)"(?P<raw>.*?)"(?P=hashes) | "(?P<text>(?:\\.|[^"\\])*)" | '(?:\\[^']+|[^'\\])'""",
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)
CODE = re.compile(r"`[^`]*`")
ONLY_SQL = re.compile(r"(?-i:\b(SELECT|REPLACE INTO|INSERT|UPDATE|DELETE FROM|IS NOT NULL|PRAGMA|JOIN)\b)")
PAGES = ["README.md", "SECURITY.md", "CHANGELOG.md", "docs/*.md", "docs/monitoring/*", "packaging/**/*", "systemd/*"]


def phrases(file: Path) -> list[tuple[re.Pattern[str], str]]:
    lines = (line.partition("\t") for line in file.read_text(encoding="utf-8").splitlines())
    return [(re.compile(word, re.IGNORECASE), better) for word, _, better in lines if word and not word.startswith("#")]


def product_files(root: Path) -> list[Path]:
    files = sorted([*(root / "src").rglob("*.rs"), *(root / "crates").rglob("*.rs")])
    tests = {test for file in files for test in tests_of(file, file.read_text(encoding="utf-8"))}
    return [
        file
        for file in files
        if not {"tests", "examples", "benches"} & set(file.relative_to(root).parts[:-1])
        and not any(test == file.with_suffix("") or test in file.parents for test in tests)
    ]


def messages(file: Path, shows_help: bool) -> Iterator[tuple[int, str]]:
    """Literals and help of a source file with their lines; a literal's continued lines are joined."""
    source = without_inline_tests(file.read_text(encoding="utf-8"))
    for found in LITERAL.finditer(source):
        text = found["raw"] or found["text"] or ""
        if found["help"] and shows_help:
            text = found["help"]
        text = re.sub(r"\\\n\s*", "", text)
        if len(re.findall(r"[A-Za-z']{2,}", text)) > 1 and not ONLY_SQL.search(text):
            yield source.count("\n", 0, found.start()) + 1, text


def page_lines(file: Path) -> Iterator[tuple[int, str]]:
    in_code = False
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        fence = line.lstrip().startswith("```")
        if not in_code and not fence:
            yield number, line
        in_code ^= fence


def what_people_read(root: Path) -> Iterator[tuple[str, int, str]]:
    for file in product_files(root):
        name = str(file.relative_to(root))
        for number, text in messages(file, name.startswith("src/cli")):
            yield name, number, text
    for pattern in PAGES:
        for file in sorted(file for file in root.glob(pattern) if file.is_file()):
            for number, text in page_lines(file):
                yield str(file.relative_to(root)), number, text


def main() -> int:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent.parent)
    table = phrases(Path(__file__).with_suffix(".txt"))
    texts = hits = 0
    for name, number, text in what_people_read(root):
        texts += 1
        for word, better in table:
            for found in word.finditer(CODE.sub("` `", text)):
                hits += 1
                print(f"{name}:{number}: '{found[0]}' (better: {better}): {text.strip()[:160]}")
    print(f"{hits} hits in {texts} texts")
    return 1 if hits or texts == 0 else 0


sys.exit(main())
