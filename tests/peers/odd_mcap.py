"""MCAP files of many kinds, written and read by the format's own Python library.

usage: odd_mcap.py write DIR | odd_mcap.py read DIR

`write` makes small files of what recordings have come with. `read` prints, for each *.mcap of the folder, one line of JSON: its
name, and what the library reads of it in each of its ways (`index`: by the summary; `chunks`: in the order of the file): messages
as [topic, log time, hex], or null if the library gives up.
"""

import glob
import json
import os
import resource
import signal
import sys

from mcap.reader import NonSeekingReader, SeekingReader
from mcap.writer import CompressionType, Writer

COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}


def two_topics(writer, count=24):
    """Two topics of one length, so that one can be taken for the other; between them, what is no message."""
    schema = writer.register_schema("std_msgs/msg/UInt32", "ros2msg", b"uint32 data\n")
    other = writer.register_schema("std_msgs/msg/Int32", "ros2msg", b"int32 data\n")
    channels = [
        writer.register_channel("/left", "cdr", schema, {"offered_qos_profiles": ""}),
        writer.register_channel("/righ", "cdr", other),
    ]
    writer.add_metadata("begun", {"by": "the test"})
    for number in range(count):
        body = b"\x00\x01\x00\x00" + number.to_bytes(4, "little")
        writer.add_message(channels[number % 2], 10**9 + number * 1000, body, 10**9 + number, number)
        if number == count // 2:
            writer.add_attachment(5, 10**9, "map", "image/png", b"\x89PNG")


def of_ros_1(writer):
    schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
    about = {"callerid": "/teller", "latching": "0", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1"}
    channel = writer.register_channel("/words", "ros1", schema, about)
    for number, at in enumerate((7, 7, 3, 0, 2**62)):
        text = b"word %d" % number
        writer.add_message(channel, at, len(text).to_bytes(4, "little") + text, at)


def mixed(writer):
    """Messages that can be used beside some that cannot, and a body without a definition."""
    schema = writer.register_schema("std_msgs/msg/String", "", b"")
    known = writer.register_channel("/known", "cdr", schema)
    json_schema = writer.register_schema("Json", "jsonschema", b"{}")
    strange = writer.register_channel("/strange", "json", json_schema)
    for number in range(6):
        writer.add_message(known, number, b"\x00\x01\x00\x00\x02\x00\x00\x00a\x00", number)
        writer.add_message(strange, number, b"{}", number)


def write(folder):
    def record(name, fill, **ways):
        with open(os.path.join(folder, name + ".mcap"), "wb") as file:
            writer = Writer(file, **{"chunk_size": 400, "compression": CompressionType.NONE, **ways})
            writer.start("ros1" if fill is of_ros_1 else "ros2", "test")
            fill(writer)
            writer.finish()

    for name, compression in COMPRESSIONS.items():
        record("two_" + name, two_topics, compression=compression)
    record("two_whole", two_topics, use_chunking=False, enable_data_crcs=True)
    record("two_bare", two_topics, use_chunking=False, enable_crcs=False, use_statistics=False, use_summary_offsets=False)
    record("two_unchecked", two_topics, enable_crcs=False)
    record("two_once", two_topics, repeat_channels=False, repeat_schemas=False)
    record("ros_1", of_ros_1, compression=CompressionType.LZ4)
    record("mixed", mixed, compression=CompressionType.ZSTD)


def messages(reader):
    return [[channel.topic, message.log_time, message.data.hex()] for _, channel, message in reader.iter_messages()]


def by_index(path):
    with open(path, "rb") as file:
        return messages(SeekingReader(file, validate_crcs=True))


def by_chunks(path):
    with open(path, "rb") as file:
        return messages(NonSeekingReader(file, validate_crcs=True))


class Slow(Exception):
    pass


def slow(*_):
    raise Slow()


def tried(read, path):
    # A length that lies must cost neither time nor memory.
    signal.alarm(20)
    try:
        return read(path)
    except Exception:
        return None
    finally:
        signal.alarm(0)


def read(folder):
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    signal.signal(signal.SIGALRM, slow)
    for path in sorted(glob.glob(os.path.join(folder, "*.mcap"))):
        line = {"name": os.path.basename(path), "index": tried(by_index, path), "chunks": tried(by_chunks, path)}
        print(json.dumps(line), flush=True)


{"write": write, "read": read}[sys.argv[1]](sys.argv[2])
