"""Prints what a bag holds, as JSON, read by ROS's own Python library: lengths, bytes and fields per topic."""

import json
import sys

import rosbag
from roslib.message import get_message_class


def plain(value):
    if hasattr(value, "__slots__") and hasattr(value, "_type"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if hasattr(value, "to_nsec"):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


topics = {}
with rosbag.Bag(sys.argv[1]) as bag:
    for topic, raw, _ in bag.read_messages(raw=True):
        type_name, data = raw[0], raw[1]
        entry = topics.setdefault(topic, {"type": type_name, "bodies": [], "messages": []})
        message = get_message_class(type_name)()
        message.deserialize(data)
        entry["bodies"].append(data.hex())
        entry["messages"].append(plain(message))
json.dump(topics, sys.stdout)
