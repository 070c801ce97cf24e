"""Prints what an MCAP file holds beside its messages, as mcap's own reader finds it by the summary, as one line of JSON.

usage: mcap_beside.py FILE
"""

import json
import sys

from mcap.reader import make_reader


def main():
    with open(sys.argv[1], "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [
            [one.log_time, one.create_time, one.name, one.media_type, one.data.hex()] for one in reader.iter_attachments()
        ]
        found += [[one.name, one.metadata] for one in reader.iter_metadata()]
    print(json.dumps(sorted(found, key=json.dumps)))


main()
