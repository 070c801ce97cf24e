#!/usr/bin/env python3
"""What robots need, from measured constants: `tools/scale.py` prints the tables of docs/scale.md.

`tools/scale.py ROBOTS RATE BYTES` prints the row of other robots: RATE in messages a second of each robot, BYTES of
each message. Only the standard library is used.
"""

import sys
from math import ceil

# Measured; docs/scale.md names the run of each.
SITE_RATE = 4_000  # messages of 1 KiB a second, captured to verified, held on two cores
GATEWAY_RATE = 16_000  # records of 1 KiB a second and core that a gateway takes
PICTURES_RATE = 120  # pictures of 58 KB a second, captured to verified, held on two cores
BATCH_GAS = 56_825  # a batch of 1 to 16,384 records
SINGLE_GAS = 64_786  # one record by itself

# Given by the format and the code.
BATCH_MOST = 16_384  # records in one batch
BATCHES = 1  # a second and anchoring account, while records come
HEADER = 220 + 8  # bytes: public header with the id of the type
TAGS = 32  # bytes: the tags of head and body

# Assumed, not measured.
HEAD = 160  # bytes: names, type and md5sum of a topic with short names
NODE_MEMORY = 64  # GB of memory of a Redis node

DAY = 86_400
LOADS = [
    (4, 10, 1_024),
    (60, 10, 1_024),
    (400, 10, 1_024),
    (1_000, 10, 1_024),
    (10_000, 1, 1_024),
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
    small = size <= 1_024
    # Taking records and bringing them to verified share a machine of two cores; the slower of both counts.
    held = SITE_RATE if small else PICTURES_RATE
    sites = ceil(messages / held)
    cores = rounded(messages / GATEWAY_RATE) if small else "not measured"
    stored = messages * DAY * (size + HEADER + TAGS + HEAD)
    batches = sites * DAY * max(BATCHES, ceil(messages / sites / BATCH_MOST))
    return [
        thousands(robots),
        thousands(rate),
        thousands(size),
        thousands(messages),
        cores,
        thousands(sites),
        rounded(stored / 1e9),
        rounded(NODE_MEMORY * 1e9 / (stored / DAY) / 3600),
        thousands(batches),
        rounded(batches * BATCH_GAS / 1e9),
        rounded(batches * BATCH_GAS / (messages * DAY)),
    ]


HEADINGS = [
    "robots",
    "msg/s each",
    "bytes",
    "msg/s",
    "cores to take them",
    "gateways of two cores",
    "ciphertext GB/day",
    "hours in one Redis node",
    "transactions/day",
    "Ggas/day",
    "gas a record",
]


def single():
    rows = []
    for count in (1, 100, 1_000, 4_000, BATCH_MOST):
        rows.append([thousands(count), rounded(BATCH_GAS / count), thousands(SINGLE_GAS)])
    return table(["records in a batch", "gas a record", "one by one"], rows)


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
        print()
        print(single())


if __name__ == "__main__":
    main(sys.argv[1:])
