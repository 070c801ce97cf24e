"""A DDS peer that publishes as a node of ROS 2 whose name comes late: Eclipse Cyclone DDS with ROS 2's names, types and QoS.

usage: ros2_late_name.py NODE TOPIC COUNT SECONDS

Its participant has what announces names from the start, as that of every node. It publishes COUNT texts on TOPIC, twenty a
second, from when it has a subscriber, and says that NODE is who publishes them only SECONDS after that. Before it leaves it
takes the name back, as a node does. Prints one line of JSON when it is ready, and one with what it sent.
"""

import json
import sys
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ros2_describing import Gid, NodeEntitiesInfo, ParticipantEntitiesInfo
from ros2_publisher import HASH, String


def main():
    node, topic, count, seconds = sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    participant = DomainParticipant(0)
    reliable = Policy.Reliability.Reliable(duration(seconds=10))
    kept = Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    graph = DataWriter(participant, Topic(participant, "ros_discovery_info", ParticipantEntitiesInfo, qos=kept), qos=kept)
    offered = Qos(
        reliable, Policy.Durability.Volatile, Policy.History.KeepLast(1000), Policy.Userdata(f"typehash={HASH};".encode())
    )
    writer = DataWriter(participant, Topic(participant, "rt" + topic, String), qos=offered)
    gid = lambda entity: Gid(list(entity.guid.bytes))
    tell = lambda writers: graph.write(
        ParticipantEntitiesInfo(gid(participant), [NodeEntitiesInfo("/", node, [], writers)])
    )
    print(json.dumps({"ready": True}), flush=True)
    while writer.get_publication_matched_status().current_count == 0:
        time.sleep(0.05)
    begin, named = time.monotonic(), False
    for number in range(1, count + 1):
        writer.write(String(f"{node} {number}"))
        time.sleep(0.05)
        if not named and time.monotonic() - begin >= seconds:
            tell([gid(writer)])
            named = True
    time.sleep(1)
    tell([])
    time.sleep(1)
    print(json.dumps({"sent": count}), flush=True)


if __name__ == "__main__":
    main()
