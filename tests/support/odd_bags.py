"""Bags of many kinds, written and read by ROS's own library.

usage: odd_bags.py write DIR | odd_bags.py read DIR

`write` makes small bags of what recordings have come with. `read` prints, for each *.bag of the folder, one line of JSON: its
name, and what the library reads of it in each of its ways (`index`: by the index at the end; `chunks`: after a new index was made
from the chunks): messages as [topic, nanoseconds, hex], or null if the library gives up.
"""

import glob
import json
import os
import random
import resource
import shutil
import signal
import sys

import genpy
import rosbag
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Empty, Float32MultiArray, Float64, Int64, String, UInt64MultiArray


def time(seconds, nanoseconds=0):
    return genpy.Time(seconds, nanoseconds)


def header(topic, message, **more):
    about = {
        "topic": topic,
        "type": message._type,
        "md5sum": message._md5sum,
        "message_definition": message._full_text,
    }
    about.update(more)
    return about


def run(count=30):
    """A simulator's run of two topics of one length, so that one can be taken for the other."""
    for number in range(count):
        yield "/left", Float64(data=number), time(1 + number // 10, number % 10 * 100000000), {"callerid": "/l", "latching": "0"}
        yield "/righ", Float64(data=-number), time(1 + number // 10, number % 10 * 100000000), {"callerid": "/r"}


def odd():
    """Nothing in a message, equal times, times that go back, the first and the last nanosecond, one topic of two types."""
    for at in (time(0, 1), time(5), time(5), time(4)):
        yield "/empty", Empty(), at, {}
    yield "/late", String(data="last"), time(4294967295, 999999999), {"latching": "1"}
    yield "/text", String(data="h\u00e4ll\u00f6 \u4e16\u754c\x00 behind a zero"), time(6), {}
    yield "/two", String(data="a text"), time(8), {"callerid": "/one"}
    yield "/two", Int64(data=-(2**63)), time(8), {"callerid": "/other"}


def names():
    for name in ("ground", "foo/bar", "ORB-SLAM", "/ok", "/1num", " /sp", "/a//b", "~priv"):
        yield name, String(data=name), time(6), {}


def types():
    chance = random.Random(3)
    number = lambda: chance.choice([float("nan"), float("-inf"), -0.0, 5e-324, 0.1, chance.uniform(-1e3, 1e3)])
    for second in range(3):
        cloud = PointCloud2(height=1, width=2, point_step=4, row_step=8, data=chance.randbytes(8), is_dense=True)
        cloud.fields = [PointField("x", 0, 7, 1)]
        odometry = Odometry(child_frame_id="base \u00e9")
        odometry.pose.covariance = [number() for _ in range(36)]
        arrays = Float32MultiArray(data=[1.5, -0.0]), UInt64MultiArray(data=[2**64 - 1, 2**53 + 1])
        for topic, message in zip(("/cloud", "/odom", "/f32", "/u64"), (cloud, odometry, *arrays)):
            yield topic, message, time(100 + second, chance.randrange(10**9)), {}


def record(path, messages, compression="none", threshold=600):
    with rosbag.Bag(path, "w", compression=compression, chunk_threshold=threshold) as bag:
        for topic, message, at, more in messages:
            bag.write(topic, message, at, connection_header=header(topic, message, **more))


def killed(path):
    """As a recorder leaves it that is killed after a chunk: without an index."""
    with open(path, "r+b") as file:
        held = bytearray(file.read())
        place = held.index(b"index_pos=") + 10
        end = int.from_bytes(held[place : place + 8], "little")
        held[place : place + 8] = bytes(8)
        file.seek(0)
        file.write(held[:end])
        file.truncate()


def write(folder):
    at = lambda name: os.path.join(folder, name + ".bag")
    for compression in ("none", "bz2", "lz4"):
        record(at("run_" + compression), run(), compression)
    record(at("odd"), odd())
    record(at("names"), names(), "lz4")
    record(at("types"), types(), "bz2", 2000)
    record(at("one_each"), run(8), "none", 10)
    record(at("killed"), run())
    killed(at("killed"))


def messages(path):
    with rosbag.Bag(path) as bag:
        return [[topic, at.to_nsec(), raw[1].hex()] for topic, raw, at in bag.read_messages(raw=True)]


def by_index(path):
    return messages(path)


def by_chunks(path):
    copy = path + ".copy"
    shutil.copyfile(path, copy)
    try:
        with rosbag.Bag(copy, "a", allow_unindexed=True) as bag:
            for _ in bag.reindex():
                pass
        return messages(copy)
    finally:
        os.remove(copy)


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
    for path in sorted(glob.glob(os.path.join(folder, "*.bag"))):
        line = {"name": os.path.basename(path), "index": tried(by_index, path), "chunks": tried(by_chunks, path)}
        print(json.dumps(line), flush=True)


{"write": write, "read": read}[sys.argv[1]](sys.argv[2])
