"""Reads a ROS 2 recording by mcap and mcap-ros2-support, and prints all that they find in it as one line of JSON.

usage: ros2_mcap.py FILE

Each message with its topic, times, number, bytes (as SHA-256), type, definition, metadata of its channel, and its decoded
text; of what mcap-ros2-support cannot decode, the reason instead. In the order of the file's index.
"""

import hashlib
import json
import sys

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


def decoded(decoders, channel, schema, message):
    try:
        decoder = decoders.decoder_for(channel.message_encoding, schema)
        return repr(decoder(message.data)) if decoder else "no decoder for " + schema.encoding
    except McapError as error:
        return type(error).__name__


def main():
    found, decoders = [], DecoderFactory()
    with open(sys.argv[1], "rb") as file:
        # CRCs of chunks are checked.
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            found.append(
                {
                    "topic": channel.topic,
                    "type": schema.name,
                    "definition": schema.data.decode(),
                    "schema": schema.encoding,
                    "encoding": channel.message_encoding,
                    "metadata": channel.metadata,
                    "logged": message.log_time,
                    "published": message.publish_time,
                    "sequence": message.sequence,
                    "sha256": hashlib.sha256(message.data).hexdigest(),
                    "decoded": decoded(decoders, channel, schema, message),
                }
            )
    print(json.dumps(found))


main()
