#!/usr/bin/env python3
"""Looks for the phrases of `tests/words.txt` in what people read: messages, help, screens and pages. `tests/words.py [CHECKOUT]`.

Messages are the literals of two words or a heading in product code, help is the doc comments of `src/cli`. Names are not judged: what
stands between backticks or in a code block, placeholders, NAMES. A number before a plural noun is a hit too. Ends with 1 if there is a hit.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

sys.dont_write_bytecode = True
from count_lines import tests_of, without_inline_tests  # noqa: E402

LITERAL = re.compile(
    r"""(?P<help>(?:^[ ]*///[^\n]*\n)+) | //[^\n]* | /\*.*?\*/
    | b?r(?P<hashes>\#*)"(?P<raw>.*?)"(?P=hashes) | "(?P<text>(?:\\.|[^"\\])*)" | '(?:\\[^']+|[^'\\])'""",
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)
# Settings, commands, and the contract's own words.
NAMES = r"^no loan$|\bgateway\.admission\b|\bhand-over\b"
NOT_JUDGED = re.compile(r"`[^`]*`|\{[^}]*\}|" + NAMES)
# Of a lint's exception: for the next engineer.
REASON = re.compile(r"\breason\s*=\s*$")
# Two words, or the heading of a column.
MESSAGE = re.compile(r"[A-Za-z']{2,}.*?[^A-Za-z'].*?[A-Za-z']{2,}|^[A-Z][a-z]+$", re.DOTALL)
# A number and its noun, which `counted` joins: not of a limit, and not a rate.
UNCOUNTED = re.compile(
    r"(?<![\w{])\{(?!most\}|limit\}|all\}|format\})[a-z_0-9]*\} (?:(?:more|other) )?(?:accounts|alerts|batches|blocks|"
    r"chunks|connections|copies|days|deliveries|devices|entries|epochs|events|files|frames|gaps|grants|heads|incidents|lines|"
    r"losses|messages|minutes|notes|owners|parts|pictures|places|profiles|publishers|readers|records|requests|robots|rows|rules|"
    r"signatures|stamps|times|topics|transactions)\b(?!/)"
)
ONLY_SQL = re.compile(r"(?-i:\b(SELECT|REPLACE INTO|INSERT|UPDATE|DELETE FROM|IS NOT NULL|PRAGMA|JOIN)\b)")
PAGES = [
    "*.md", "docs/*.md", "docs/decisions/*.md", "docs/monitoring/*", "crates/*/README.md", "packaging/*.1", "packaging/debian/*",
    "packaging/ros2/authros/*.xml", "systemd/*",
]


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
        if REASON.search(source, max(0, found.start() - 20), found.start()):
            continue
        text = found["raw"] or found["text"] or ""
        if found["help"] and shows_help:
            text = re.sub(r"\n?[ ]*///", "", found["help"])
        text = re.sub(r"\\\n\s*", "", text)
        if MESSAGE.search(text) and not ONLY_SQL.search(text):
            yield source.count("\n", 0, found.start()) + 1, text


def paragraphs(file: Path) -> Iterator[tuple[int, str]]:
    """Paragraphs with their first lines, without blocks of code."""
    in_code, lines, first = False, [], 1
    for number, line in enumerate([*file.read_text(encoding="utf-8").splitlines(), ""], 1):
        fence = line.lstrip().startswith("```")
        if fence or in_code or not line.strip():
            if lines:
                yield first, " ".join(lines)
            in_code, lines, first = in_code ^ fence, [], number + 1
        else:
            lines.append(line.strip())


def what_people_read(root: Path) -> Iterator[tuple[str, int, str]]:
    for file in product_files(root):
        name = str(file.relative_to(root))
        for number, text in messages(file, name.startswith("src/cli")):
            yield name, number, text
    for pattern in PAGES:
        for file in sorted(file for file in root.glob(pattern) if file.is_file()):
            for number, text in paragraphs(file):
                yield str(file.relative_to(root)), number, text


def uncounted(root: Path) -> Iterator[tuple[str, int, str]]:
    for file in product_files(root):
        for number, text in messages(file, False):
            for found in UNCOUNTED.finditer(text):
                yield str(file.relative_to(root)), number, found[0]


def around(text: str, hit: str) -> str:
    place = max(0, text.find(hit))
    return text[max(0, place - 60) : place + 90].strip()


def main() -> int:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent.parent)
    table = phrases(Path(__file__).with_suffix(".txt"))
    texts = hits = 0
    for name, number, text in what_people_read(root):
        texts += 1
        for word, better in table:
            for found in word.finditer(NOT_JUDGED.sub("_", text)):
                hits += 1
                print(f"{name}:{number}: '{found[0]}' (better: {better}): {around(text, found[0])}")
    for name, number, found in uncounted(root):
        hits += 1
        print(f"{name}:{number}: '{found}' (better: `model::counted`, which knows 1 and groups digits)")
    print(f"{hits} hits in {texts} texts")
    return 1 if hits or texts == 0 else 0


sys.exit(main())
