"""Real nodes of ROS 2 (rclpy) in one process each, which publish std_msgs/msg/String.

usage: ros2_identity.py NODE TOPIC HERTZ COUNT

Publishes COUNT texts (0: for ever) on TOPIC as node NODE, reliable, from when it has a subscriber. Prints one line of JSON
when it is ready, and one with what it sent when all was acknowledged; then it shuts down as a node does.
"""

import json
import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String


def main():
    name, topic, hertz, count = sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4])
    rclpy.init()
    node = rclpy.create_node(name)
    profile = QoSProfile(depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
    publisher = node.create_publisher(String, topic, profile)
    print(json.dumps({"ready": True}), flush=True)
    while publisher.get_subscription_count() == 0:
        rclpy.spin_once(node, timeout_sec=0.05)
    # The subscriber may learn of this publisher a moment later, and what was sent before is not for it.
    time.sleep(1)
    begin, number = time.monotonic(), 0
    while count == 0 or number < count:
        wait = begin + number / hertz - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        number += 1
        publisher.publish(String(data=f"{name} {number}"))
    publisher.wait_for_all_acked(Duration(seconds=30))
    print(json.dumps({"sent": number}), flush=True)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
