"""Writes MCAP into a folder as rosbag2's recorder does: splits, chunks, a description when it ends.

usage: ros2_follow.py FOLDER SECONDS RATE SPLIT_SECONDS HOW

HOW is zstd, lz4, none (chunks without compression) or unchunked. Each message goes to one of three topics and carries its
number; half-way the clock that stamps them is set back by an hour. Prints what was recorded as one line of JSON.
"""

import json
import os
import struct
import sys
import time

import rosbag2_description
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

STRING = "std_msgs/msg/String", "string data"
IMAGE = "sensor_msgs/msg/CompressedImage", (
    "std_msgs/Header header\nstring format\nuint8[] data\n" + "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
    "string frame_id\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
TOPICS = {"/numbers": STRING, "/robot1/words": STRING, "/camera/image/compressed": IMAGE}
QOS = "- history: 1\n  depth: 10\n  reliability: 1\n  durability: 2\n"


class Unbuffered:
    """A file whose every write is on its way to the disk when it returns."""

    def __init__(self, path):
        self.file = open(path, "wb", buffering=0)

    def write(self, data):
        left = memoryview(bytes(data))
        while left:
            left = left[self.file.write(left):]
        return len(data)

    def tell(self):
        return self.file.tell()

    def flush(self):
        pass

    def close(self):
        self.file.close()


def cdr_text(text):
    raw = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(raw)) + raw


def cdr_image(number):
    data = bytes((number * 7 + at) % 256 for at in range(400))
    body = struct.pack("<iI", number, 5) + struct.pack("<I", 4) + b"cam\0" + struct.pack("<I", 5) + b"jpeg\0\0\0\0"
    return b"\0\1\0\0" + body + struct.pack("<I", len(data)) + data


def begin(folder, name, number, how):
    out = Unbuffered(os.path.join(folder, f"{name}_{number}.mcap"))
    compression = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}.get(how, CompressionType.NONE)
    writer = Writer(out, chunk_size=48 * 1024, compression=compression, use_chunking=how != "unchunked")
    writer.start(profile="ros2", library="libmcap 1.4.0")
    writer.add_metadata("rosbag2", {"serialized_metadata": f"version: 9\nstarting_time:\n  nanoseconds_since_epoch: {number}\n"})
    return out, writer, {}


def main():
    folder, seconds, rate, split, how = sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), sys.argv[5]
    os.mkdir(folder)
    name, total = os.path.basename(folder), int(seconds * rate)
    out = writer = None
    channels, files, schemas, begun, split_at = {}, 0, {}, time.monotonic(), 0
    for number in range(total):
        wait = begun + number / rate - time.monotonic()
        if wait > 0.002:
            time.sleep(wait)
        if writer is None or time.monotonic() - split_at >= split:
            if writer is not None:
                writer.finish()
                out.close()
            out, writer, channels = begin(folder, name, files, how)
            files, schemas, split_at = files + 1, {}, time.monotonic()
        topic = list(TOPICS)[number % 3]
        if topic not in channels:
            type_name, text = TOPICS[topic]
            if type_name not in schemas:
                schemas[type_name] = writer.register_schema(type_name, SchemaEncoding.ROS2, text.encode())
            about = {"offered_qos_profiles": QOS, "topic_type_hash": "RIHS01_" + "0" * 64}
            channels[topic] = writer.register_channel(topic, MessageEncoding.CDR, schemas[type_name], about)
        stamp = 1_790_000_000_000_000_000 + number * 1_000_003 - (3_600_000_000_000 if number > total // 2 else 0)
        data = cdr_image(number) if topic.endswith("compressed") else cdr_text(f"message {number} of {topic} " + "x" * (number % 90))
        writer.add_message(channels[topic], stamp, data, stamp - 1_000, number // 3)
    writer.add_metadata("rosbag2", {"serialized_metadata": "version: 9\n"})
    writer.finish()
    out.close()
    rosbag2_description.write(folder, "mcap", files, total)
    print(json.dumps({"messages": total, "files": files}))


main()
