"""Bags by ROS's own Python library: written, listed, and heard while rosbag plays them."""

import json
import random
import sys
import threading

import genpy
import rosbag


# The topic whose publishers latch.
LATCHED = "/calibration"


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


def robot():
    """A wheeled robot of a minute: odometry and an inertial unit at 50 Hz, every field filled, by a fixed seed."""
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Imu

    chance = random.Random(3060)
    noise = lambda count: [chance.uniform(-1, 1) for _ in range(count)]
    for number in range(3061):
        stamp = genpy.Time(1700000000 + number // 50, (number % 50) * 20000000 + chance.randrange(2000000))
        imu = Imu(orientation_covariance=noise(9), angular_velocity_covariance=noise(9))
        imu.header.seq, imu.header.stamp, imu.header.frame_id = number, stamp, "imu_link"
        imu.linear_acceleration.x, imu.linear_acceleration.y, imu.linear_acceleration.z = noise(3)
        yield "/imu/data", imu, stamp, "/imu_driver"
        if number == 3060:
            return
        odometry = Odometry(child_frame_id="base_link")
        odometry.header.seq, odometry.header.stamp, odometry.header.frame_id = number, stamp, "odom"
        odometry.pose.covariance, odometry.twist.covariance = noise(36), noise(36)
        odometry.pose.pose.position.x, odometry.pose.pose.position.y, _ = noise(3)
        odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w = noise(2)
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = noise(2)
        yield "/jackal_velocity_controller/odom", odometry, stamp, "/jackal_velocity_controller"


def simulated(count, seed):
    """A simulator's run: it begins at the same stamp each time, and only the values differ."""
    from std_msgs.msg import Float64

    for number in range(count):
        time = genpy.Time(100 + number // 100, (number % 100) * 10000000)
        yield "/sim/x", Float64(data=number + seed / 1000), time, "/simulator"


def latched():
    """A drive with what a robot says only once: where its parts are, of two publishers that latch."""
    from geometry_msgs.msg import TransformStamped
    from nav_msgs.msg import Odometry
    from std_msgs.msg import String

    for number, caller in enumerate(["/arm", "/base"]):
        transform = TransformStamped(child_frame_id="frame%d" % number)
        transform.transform.translation.x = number + 0.5
        yield LATCHED, transform, genpy.Time(1700000000, number), caller
    for number in range(300):
        time = genpy.Time(1700000001 + number // 100, (number % 100) * 10000000)
        odometry = Odometry(child_frame_id="base_link")
        odometry.header.seq, odometry.header.stamp = number, time
        odometry.pose.pose.position.x = number / 3
        yield "/odom", odometry, time, "/base"
        if number % 10 == 0:
            yield "/words", String(data="number %d %s" % (number, "x" * (number * 371 % 50000))), time, "/talker"


def pictures(count):
    """A camera's ten pictures a second, of a megabyte each, which nothing compresses."""
    from sensor_msgs.msg import CompressedImage

    chance = random.Random(1000)
    for number in range(count):
        time = genpy.Time(1700000000 + number // 10, (number % 10) * 100000000)
        picture = CompressedImage(format="jpeg", data=chance.randbytes(1000000))
        picture.header.seq, picture.header.stamp, picture.header.frame_id = number, time, "camera"
        yield "/camera", picture, time, "/camera_driver"


def named():
    """Names as rosbag takes them: absolute, relative, and with characters that no graph name has."""
    from std_msgs.msg import String

    names = ["/ok", "foo", "foo/bar", "ORB-SLAM", "ORB_SLAM", "/1num", "x" * 300]
    for number, name in enumerate(names * 3):
        yield name, String(data="%d" % number), genpy.Time(100 + number), "/talker"


def header(topic, message, caller):
    about = {
        "topic": topic,
        "type": message._type,
        "md5sum": message._md5sum,
        "message_definition": message._full_text,
        "callerid": caller,
        "latching": "1" if topic == LATCHED else "0",
    }
    if caller == "/driver":
        # As some recorders leave it out, with a field that no recorder of ours knows.
        del about["topic"]
        about["tcp_nodelay"] = "1"
    return about


def write(path, compression, count):
    record(path, compression, messages(int(count)))


def record(path, compression, all_messages):
    with rosbag.Bag(path, "w", compression=compression, chunk_threshold=64 * 1024) as bag:
        for topic, message, time, caller in all_messages:
            bag.write(topic, message, time, connection_header=header(topic, message, caller))


def listed(path):
    """One entry for each message: topic, type, md5sum, caller, definition, time, bytes, latching, and the topic in the
    connection's own header."""
    entries = []
    with rosbag.Bag(path) as bag:
        for topic, raw, time, about in bag.read_messages(raw=True, return_connection_header=True):
            text = lambda name: about.get(name, b"").decode()
            entry = [topic, raw[0], raw[2], text("callerid"), text("message_definition"), time.to_nsec(), raw[1].hex()]
            entry += [name in about and text(name) for name in ("latching", "topic", "tcp_nodelay")]
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


{"write": write, "robot": lambda path: record(path, "bz2", robot()), "simulated": lambda path, count, seed: record(path, "none", simulated(int(count), int(seed))),
 "latched": lambda path: record(path, "none", latched()), "pictures": lambda path, count: record(path, "none", pictures(int(count))), "named": lambda path: record(path, "lz4", named()), "list": listed, "hear": hear}[sys.argv[1]](*sys.argv[2:])
