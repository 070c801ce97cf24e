"""A real node of ROS 2 (rclpy), of the distribution whose Python runs this. ROS_DOMAIN_ID names the domain.

    ros2_node.py publish TOPIC [--rate HZ] [--number N] [--keep-all] [--depth N] [--best-effort] [--latched] [--size BYTES] [--name NODE]
                              [--topics N] (N of them, named TOPIC0 and so on)
                              [--patient] (begins a second after somebody came; at its end tells what it sent once all is acknowledged)
    ros2_node.py subscribe TOPIC [--seconds S] (and the options of QoS)

Messages are std_msgs/String. Prints one JSON object a line: {"ready": true}; {"sent": n, "at": seconds} ten times a second;
{"subscribers": [...]} or {"publishers": [...]} (GUIDs as hex of others on the topic) whenever they change; {"heard": n} ten times a second;
{"error": text} for an exception, after which nothing is published; {"done": n, "seconds": s} after the last message. It goes on
telling who is there until SIGTERM, then shuts down in order and prints {"over": true}.
"""
import argparse
import json
import signal
import threading
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

TICK = 0.1
FOR_EVER = 1e9

parser = argparse.ArgumentParser()
parser.add_argument("act", choices=["publish", "subscribe"])
parser.add_argument("topic")
parser.add_argument("--name", default="node")
parser.add_argument("--rate", type=float, default=10)
parser.add_argument("--number", type=int, default=1_000_000_000)
parser.add_argument("--seconds", type=float, default=FOR_EVER)
parser.add_argument("--depth", type=int, default=10)
parser.add_argument("--size", type=int, default=0)
parser.add_argument("--topics", type=int, default=1)
for flag in ("--keep-all", "--best-effort", "--latched", "--patient"):
    parser.add_argument(flag, action="store_true")
asked = parser.parse_args()
printing = threading.Lock()


def say(**words):
    with printing:
        print(json.dumps(words), flush=True)


def quality():
    profile = QoSProfile(depth=asked.depth)
    profile.history = HistoryPolicy.KEEP_ALL if asked.keep_all else HistoryPolicy.KEEP_LAST
    profile.reliability = ReliabilityPolicy.BEST_EFFORT if asked.best_effort else ReliabilityPolicy.RELIABLE
    profile.durability = DurabilityPolicy.TRANSIENT_LOCAL if asked.latched else DurabilityPolicy.VOLATILE
    return profile


over = threading.Event()


def watch(node):
    """Tells who is on the other side of the topic, and whenever that changes."""
    name = "subscribers" if asked.act == "publish" else "publishers"
    look = getattr(node, f"get_{'subscriptions' if asked.act == 'publish' else 'publishers'}_info_by_topic")
    before = None
    while not over.wait(TICK):
        now = sorted(bytes(found.endpoint_gid).hex() for found in look(asked.topic))
        if now != before:
            before = now
            say(**{name: now, "at": time.time()})


def publish(node):
    names = [asked.topic] if asked.topics == 1 else [f"{asked.topic}{number}" for number in range(asked.topics)]
    publishers = [node.create_publisher(String, name, quality()) for name in names]
    say(ready=True)
    while asked.patient and not over.is_set() and publishers[0].get_subscription_count() == 0:
        over.wait(TICK)
    over.wait(1 if asked.patient else 0)
    begun, told = time.monotonic(), 0.0
    for number in range(asked.number):
        wait = begun + number / asked.rate - time.monotonic()
        if over.wait(max(wait, 0)) if wait > 0 else over.is_set():
            if asked.patient:
                publishers[0].wait_for_all_acked(Duration(seconds=30))
                say(sent=number)
            return
        try:
            for publisher in publishers:
                publisher.publish(String(data=f"{number:08} " + "x" * asked.size))
        except Exception as error:  # whatever a robot's node would die of
            say(error=str(error), sent=number)
            return
        if time.monotonic() - told >= TICK:
            told = time.monotonic()
            say(sent=number + 1, at=time.time())
    say(done=asked.number, sent=asked.number, seconds=time.monotonic() - begun)


def subscribe(node):
    heard = 0

    def hear(_message):
        nonlocal heard
        heard += 1

    node.create_subscription(String, asked.topic, hear, quality())
    say(ready=True)
    begun, told = time.monotonic(), 0.0
    while not over.is_set() and time.monotonic() - begun < asked.seconds:
        rclpy.spin_once(node, timeout_sec=TICK)
        if time.monotonic() - told >= TICK:
            told = time.monotonic()
            say(heard=heard)
    say(heard=heard)


signal.signal(signal.SIGTERM, lambda *_: over.set())
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node(asked.name)
threading.Thread(target=watch, args=(node,), daemon=True).start()
(publish if asked.act == "publish" else subscribe)(node)
if asked.seconds == FOR_EVER:
    over.wait()
over.set()
time.sleep(2 * TICK)
node.destroy_node()
rclpy.try_shutdown()
say(over=True)
