"""A real node of ROS 2 (rclpy) that subscribes to topics and prints what it receives.

usage: ros2_bridge.py DOMAIN TOPIC:KIND:RELIABILITY...

KIND is `string` or `image` (sensor_msgs/CompressedImage), RELIABILITY `reliable` or `best_effort`. Prints one line of JSON for
each message, with the SHA-256 of its bytes as they arrived, encapsulation header included; one whenever the publishers of its
topics change, with the node, type and type hash of each as the graph tells them; stays until it is ended.
"""

import hashlib
import json
import os
import sys
import time

os.environ["ROS_DOMAIN_ID"] = sys.argv[1]

import rclpy  # noqa: E402
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from sensor_msgs.msg import CompressedImage  # noqa: E402
from std_msgs.msg import String  # noqa: E402

KINDS = {"string": String, "image": CompressedImage}


def say(**what):
    print(json.dumps(what), flush=True)


def publishers(node, topic):
    told = node.get_publishers_info_by_topic(topic)
    return [[one.node_namespace + one.node_name, one.topic_type, str(one.topic_type_hash)] for one in told]


def main():
    rclpy.init()
    node = rclpy.create_node("bridge_subscriber")
    kept, topics = [], []
    for asked in sys.argv[2:]:
        topic, kind, reliability = asked.split(":")
        made = KINDS[kind]
        qos = QoSProfile(depth=100 if kind == "string" else 10, history=HistoryPolicy.KEEP_LAST)
        best_effort = reliability == "best_effort"
        qos.reliability = ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE

        def heard(message, topic=topic, made=made):
            deserialize_message(message, made)
            say(topic=topic, sha256=hashlib.sha256(message).hexdigest(), bytes=len(message), at=time.time())

        kept.append(node.create_subscription(made, topic, heard, qos, raw=True))
        topics.append(topic)
    say(ready=True)
    graph, looked = None, 0.0
    while True:
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() - looked < 0.5:
            continue
        looked = time.monotonic()
        now = {topic: publishers(node, topic) for topic in topics}
        nodes = [namespace.rstrip("/") + "/" + name for name, namespace in node.get_node_names_and_namespaces()]
        if (now, nodes) != graph:
            graph = (now, nodes)
            say(publishers=now, nodes=nodes)


if __name__ == "__main__":
    main()
