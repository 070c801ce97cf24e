"""Bags by ROS's own Python library: written, listed, and heard while rosbag plays them."""

import json
import sys
import threading

import genpy
import rosbag


def messages(count):
    """Messages of several types, sizes and publishers, with times of their own."""
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu
    from std_msgs.msg import String

    for number in range(count):
        time = genpy.Time(1700000000 + number // 50, (number % 50) * 20000000 + 7 * number)
        odometry = Odometry()
        odometry.header.seq = number
        odometry.header.stamp = time
        odometry.pose.pose.position.x = number / 3
        yield "/odom", odometry, time, "/base"
        imu = Imu()
        imu.header.seq = number
        imu.header.frame_id = "imu_link"
        yield "/imu/data", imu, time, "/driver"
        if number % 10 == 0:
            yield "/words", String(data="number %d %s" % (number, "x" * (number * 37 % 5000))), time, "/talker"


def header(topic, message, caller):
    return {
        "topic": topic,
        "type": message._type,
        "md5sum": message._md5sum,
        "message_definition": message._full_text,
        "callerid": caller,
    }


def write(path, compression, count):
    with rosbag.Bag(path, "w", compression=compression, chunk_threshold=64 * 1024) as bag:
        for topic, message, time, caller in messages(int(count)):
            bag.write(topic, message, time, connection_header=header(topic, message, caller))


def listed(path):
    """One entry for each message: topic, type, md5sum, caller, definition, time, bytes."""
    entries = []
    with rosbag.Bag(path) as bag:
        for topic, raw, time, about in bag.read_messages(raw=True, return_connection_header=True):
            text = lambda name: about.get(name, b"").decode()
            entry = [topic, raw[0], raw[2], text("callerid"), text("message_definition"), time.to_nsec(), raw[1].hex()]
            entries.append(entry)
    json.dump(entries, sys.stdout)


def hear(count, *topics):
    """Every message of the topics as bytes, until `count` have arrived or nothing more does."""
    import rospy

    rospy.init_node("ear", anonymous=True, disable_signals=True)
    heard, arrived = {topic: [] for topic in topics}, threading.Condition()

    def take(message, topic):
        with arrived:
            heard[topic].append(message._buff.hex())
            arrived.notify()

    for topic in topics:
        rospy.Subscriber(topic, rospy.AnyMsg, take, callback_args=topic, tcp_nodelay=True)
    print("listening", file=sys.stderr, flush=True)
    with arrived:
        arrived.wait_for(lambda: sum(map(len, heard.values())) >= int(count), timeout=90)
        json.dump(heard, sys.stdout)
    sys.stdout.flush()
    rospy.signal_shutdown("heard")


{"write": write, "list": listed, "hear": hear}[sys.argv[1]](*sys.argv[2:])
