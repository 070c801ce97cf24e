#!/usr/bin/env python3
"""What robots need, from measured constants: `tools/scale.py` prints the table of docs/gateway.md.

`tools/scale.py ROBOTS RATE BYTES` prints the row of other robots: RATE in messages a second of each robot, BYTES of
each message. Only the standard library is used.
"""

import sys
from math import ceil

# Measured; docs/gateway.md names the run of each.
SITE_RATE = 4_000  # messages of 1 KiB a second, captured to verified, held on two cores
PICTURES_RATE = 120  # pictures of 58 KB a second, captured to verified, held on two cores
BATCH_GAS = 56_825  # a batch of 1 to 16,384 records

# Given by the format and the code.
BATCH_MOST = 16_384  # records in one batch
BATCHES = 1  # a second and anchoring account, while records come
HEADER = 220 + 8  # bytes: public header with the id of the type
TAGS = 32  # bytes: the tags of head and body

# Assumed, not measured.
HEAD = 160  # bytes: names, type and md5sum of a topic with short names

DAY = 86_400
LOADS = [
    (4, 10, 1_024),
    (60, 10, 1_024),
    (400, 10, 1_024),
    (1_000, 10, 1_024),
    (10_000, 10, 1_024),
    (4, 30, 58_000),
    (100, 30, 58_000),
]


def thousands(number):
    return f"{number:,}"


def rounded(number):
    """Two digits that count: a forecast has no more."""
    if number == 0:
        return "0"
    for digits in range(0, 6):
        if round(number, digits) >= 10 ** (1 - digits):
            return f"{number:,.{digits}f}"
    return f"{number:.6f}"


def table(head, rows):
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]

    def line(cells):
        return "| " + " | ".join(cell.rjust(width) for cell, width in zip(cells, widths)) + " |"

    ruler = "|" + "|".join("-" * (width + 1) + ":" for width in widths) + "|"
    return "\n".join([line(head), ruler, *(line(row) for row in rows)])


def needs(robots, rate, size):
    messages = robots * rate
    # Taking records is faster than bringing them to verified, and both share a machine of two cores.
    sites = ceil(messages / (SITE_RATE if size <= 1_024 else PICTURES_RATE))
    stored = messages * DAY * (size + HEADER + TAGS + HEAD)
    batches = sites * DAY * max(BATCHES, ceil(messages / sites / BATCH_MOST))
    return [
        thousands(robots),
        thousands(rate),
        thousands(size),
        thousands(messages),
        thousands(sites),
        rounded(stored / 1e9),
        thousands(batches),
        rounded(batches * BATCH_GAS / 1e9),
    ]


HEADINGS = [
    "robots",
    "msg/s each",
    "bytes",
    "msg/s",
    "gateways of two cores",
    "ciphertext GB/day",
    "transactions/day",
    "Ggas/day",
]


def main(arguments):
    if len(arguments) == 3:
        try:
            wanted = [int(text) for text in arguments]
        except ValueError:
            wanted = [0]
        if min(wanted) < 1:
            sys.exit("give three whole numbers from 1 on: ROBOTS RATE BYTES")
        print(table(HEADINGS, [needs(*wanted)]))
    elif arguments:
        sys.exit(__doc__)
    else:
        print(table(HEADINGS, [needs(*one) for one in LOADS]))


if __name__ == "__main__":
    main(sys.argv[1:])
