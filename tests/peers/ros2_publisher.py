"""A DDS peer that publishes as a ROS 2 node would: Eclipse Cyclone DDS with ROS 2's names, types and QoS.

usage: ros2_publisher.py TOPIC KIND COUNT HERTZ BYTES [best_effort] [latched] [hash] [foreign] [readersN] [small_ends] [domainN]
                         [topicsN]

KIND `string`: text of BYTES characters that begins with its number; `image`: a picture of BYTES bytes. Waits for a
subscriber, or N of them, unless the topic is latched, publishes, prints one line of JSON about what it did and one whenever
the number of its subscribers changes, and stays until it is ended. With `small_ends` the first and the last picture have 100
bytes. With `topicsN` every message is published on each of N topics, `TOPIC1` to `TOPICN`, every second of them best effort.
"""

import hashlib
import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: uint32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs.msg.dds_.CompressedImage_"):
    header: Header
    format: str
    data: sequence[uint8]


def text(number, size):
    begin = f"{number} "
    return begin + "x" * (size - len(begin))


def picture(number, size):
    # A different, incompressible picture for every number.
    block = hashlib.sha256(str(number).encode()).digest() * 64
    return (block * (size // len(block) + 1))[:size]


def number_after(word, flags, usual):
    return next((int(flag[len(word):]) for flag in flags if flag.startswith(word)), usual)


def main():
    topic, kind, count, hertz, size, *flags = sys.argv[1:]
    count, hertz, size = int(count), float(hertz), int(size)
    best_effort, latched = "best_effort" in flags, "latched" in flags
    participant = DomainParticipant(number_after("domain", flags, 0))
    made = String if kind == "string" else CompressedImage

    def writer_of(topic, best_effort):
        policies = [
            Policy.Reliability.BestEffort if best_effort else Policy.Reliability.Reliable(duration(seconds=10)),
            Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(1 if latched else 100000 if kind == "string" else 20),
        ]
        qos = Qos(*policies)
        if "hash" in flags:
            qos = Qos(*policies, Policy.Userdata(f"typehash={HASH};".encode()))
        name = topic if "foreign" in flags else "rt" + topic
        return DataWriter(participant, Topic(participant, name, made, qos=Qos(*policies)), qos=qos)

    topics = number_after("topics", flags, 0)
    writers = [writer_of(f"{topic}{number}", number % 2 == 0) for number in range(1, topics + 1)]
    writers = writers or [writer_of(topic, best_effort)]
    length = lambda number: 100 if "small_ends" in flags and number in (1, count) else size
    if kind == "string":
        messages = [String(text(number, size)) for number in range(1, count + 1)]
    else:
        messages = [
            CompressedImage(Header(Time(number, 0), "camera"), "jpeg", picture(number, length(number)))
            for number in range(1, count + 1)
        ]
    digest = hashlib.sha256()
    for message in messages:
        digest.update(message.serialize(use_version_2=False))
    print(json.dumps({"ready": True}), flush=True)
    readers = number_after("readers", flags, 1)
    # The list of them (get_matched_subscriptions) fails if one comes between its two readings.
    readers_of = lambda writer: writer.get_publication_matched_status().current_count
    waits = not latched and "foreign" not in flags
    while waits and any(readers_of(writer) < readers for writer in writers):
        time.sleep(0.01)
    begin = time.monotonic()
    for number, message in enumerate(messages, 1):
        wait = begin + (number - 1) / hertz - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        for writer in writers:
            writer.write(message)
    seconds = round(time.monotonic() - begin, 3)
    print(json.dumps({"sent": count * len(writers), "seconds": seconds, "sha256": digest.hexdigest()}), flush=True)
    # As long as it runs, its last messages are repeated to subscribers that missed them.
    known = None
    while True:
        present = sum(readers_of(writer) for writer in writers)
        if present != known:
            known = present
            print(json.dumps({"readers": present}), flush=True)
        time.sleep(0.05)


if __name__ == "__main__":
    main()
