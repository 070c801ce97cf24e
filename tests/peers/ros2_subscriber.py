"""A DDS peer that subscribes as a ROS 2 node would: Eclipse Cyclone DDS with ROS 2's names, types and QoS.

usage: ros2_subscriber.py DOMAIN TOPIC KIND [best_effort] [latched]

KIND is the publisher's (ros2_publisher.py). Prints one line of JSON for each message, with the SHA-256 of its bytes as
they arrived, encapsulation header included, and one whenever the number of publishers that it hears changes; stays until it
is ended.
"""

import hashlib
import json
import sys
import time

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, Policy, Qos, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ros2_publisher import CompressedImage, String

ANY = SampleState.Any | ViewState.Any | InstanceState.Any


def say(**what):
    print(json.dumps(what), flush=True)


def main():
    domain, topic, kind, *flags = sys.argv[1:]
    best_effort, latched = "best_effort" in flags, "latched" in flags
    qos = Qos(
        Policy.Reliability.BestEffort if best_effort else Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(10 if latched else 10000),
    )
    participant = DomainParticipant(int(domain))
    made = String if kind == "string" else CompressedImage
    reader = DataReader(participant, Topic(participant, "rt" + topic, made, qos=qos), qos=qos)
    heard, number = 0, 0
    say(ready=True)
    while True:
        # The list of them (get_matched_publications) fails if one comes between its two readings.
        publishers = reader.get_subscription_matched_status().current_count
        if publishers != heard:
            heard = publishers
            say(publishers=heard)
        taken = ddspy_take(reader._ref, ANY, 100)
        for body, info in taken if isinstance(taken, list) else []:
            if info.valid_data:
                number += 1
                say(message=number, sha256=hashlib.sha256(body).hexdigest(), bytes=len(body))
        if not taken:
            time.sleep(0.005)


if __name__ == "__main__":
    main()
