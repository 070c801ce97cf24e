"""Messages by ROS's own Python: made of every type that is installed, read from a bag, compared, published.

make               one message or more of every type, as lines {type, definition, md5, body}
bag FILE           every message of a bag, in the same lines
compare MADE OURS  decodes the bodies of MADE by genpy and holds the JSON lines of OURS against it, exactly
image WIDTH HEIGHT FILE   writes the body of a raw rgb8 picture
array BYTES FILE   writes the body of a UInt8MultiArray of that length
publish TOPIC TYPE FILE HZ   publishes the body in FILE again and again
"""

import importlib
import io
import json
import math
import pkgutil
import random
import struct
import sys

import genpy
from roslib.message import get_message_class

PACKAGES = ["std_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs", "rosgraph_msgs", "actionlib_msgs"]
RANDOM = random.Random(20)


def types():
    for package in PACKAGES:
        try:
            module = importlib.import_module(package + ".msg")
        except ImportError:
            continue
        for info in sorted(pkgutil.iter_modules(module.__path__), key=lambda info: info.name):
            yield package + "/" + info.name[1:]


def number(kind):
    if kind in ("float32", "float64"):
        value = RANDOM.choice([0.0, -0.0, 1.5, 1e-30, -1e30, 1 / 3, math.nan, math.inf, RANDOM.uniform(-1e3, 1e3)])
        return struct.unpack("<f", struct.pack("<f", value))[0] if kind == "float32" else value
    bits = {"int8": 8, "byte": 8, "uint8": 8, "char": 8, "int16": 16, "uint16": 16, "int32": 32, "uint32": 32}.get(kind, 64)
    signed = kind in ("int8", "byte", "int16", "int32", "int64")
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    return RANDOM.choice([low, high, RANDOM.randint(low, high)])


def value(kind, depth):
    base, is_array, length = parse(kind)
    if is_array:
        count = length if length is not None else RANDOM.choice([0, 1, 3, 1500 if depth < 2 and base in ("uint8", "float32") else 2])
        items = [value(base, depth + 1) for _ in range(count)]
        return bytes(items) if base in ("uint8", "char") else items
    if base == "bool":
        return RANDOM.random() < 0.5
    if base == "string":
        return RANDOM.choice(["", "odom", "a\"b\\c", "\u00e9\u673a\u5668\u4eba", "line\nbreak", "x" * 5000])
    if base == "time":
        return genpy.Time(RANDOM.randint(0, 2**32 - 1), RANDOM.randint(0, 999999999))
    if base == "duration":
        return genpy.Duration(RANDOM.randint(-(2**31) + 1, 2**31 - 1), RANDOM.randint(0, 999999999))
    if base == "Header" or "/" in base:
        return filled(get_message_class("std_msgs/Header" if base == "Header" else base), depth + 1)
    return number(base)


def parse(kind):
    if not kind.endswith("]"):
        return kind, False, None
    base, length = kind[:-1].split("[")
    return base, True, int(length) if length else None


def filled(cls, depth=0):
    message = cls()
    for name, kind in zip(cls.__slots__, cls._slot_types):
        setattr(message, name, value(kind, depth))
    return message


def serialised(message):
    out = io.BytesIO()
    message.serialize(out)
    return out.getvalue()


def line(cls, body):
    record = {"type": cls._type, "definition": cls._full_text, "md5": cls._md5sum, "body": body.hex()}
    sys.stdout.write(json.dumps(record) + "\n")


def make():
    for name in types():
        cls = get_message_class(name)
        for _ in range(4):
            line(cls, serialised(filled(cls)))


def bag(path):
    import rosbag

    with rosbag.Bag(path) as source:
        for _, raw, _ in source.read_messages(raw=True):
            line(get_message_class(raw[0]), raw[1])


def plain(value):
    if hasattr(value, "__slots__") and hasattr(value, "_type"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if hasattr(value, "to_nsec"):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, bytes):
        return list(value)
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def same(one, other):
    if isinstance(one, dict):
        return isinstance(other, dict) and list(one) == list(other) and all(same(one[k], other[k]) for k in one)
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return isinstance(other, float) and struct.pack("<d", one) == struct.pack("<d", other)
    return type(one) is type(other) and one == other


def compare(made, ours):
    count, kinds = 0, set()
    with open(made) as theirs, open(ours) as mine:
        for record, text in zip(theirs, mine):
            record = json.loads(record)
            message = get_message_class(record["type"])()
            message.deserialize(bytes.fromhex(record["body"]))
            expected, found = plain(message), json.loads(text)
            if not same(expected, found):
                sys.exit("%s differs:\nrospy %.2000s\nours  %.2000s" % (record["type"], expected, found))
            count += 1
            kinds.add(record["type"])
        if theirs.readline() or mine.readline():
            sys.exit("the files have not as many lines")
    json.dump({"messages": count, "types": len(kinds)}, sys.stdout)


def image(width, height, path):
    from sensor_msgs.msg import Image

    rows = []
    for y in range(height):
        noise = RANDOM.getrandbits(width * 24).to_bytes(width * 3, "little")
        base = [40 + (x * 120 // width) + (y * 60 // height) for x in range(width)]
        rows.append(bytes(base[i // 3] + 10 * (i % 3) + (noise[i] & 3) for i in range(width * 3)))
    picture = Image(height=height, width=width, encoding="rgb8", step=width * 3, data=b"".join(rows))
    # rospy would fill in an empty one.
    picture.header.frame_id = "camera"
    with open(path, "wb") as out:
        out.write(serialised(picture))


def array(length, path):
    from std_msgs.msg import UInt8MultiArray

    block = bytes(RANDOM.getrandbits(8) for _ in range(65536))
    with open(path, "wb") as out:
        out.write(serialised(UInt8MultiArray(data=(block * (length // 65536 + 1))[:length])))


def publish(topic, name, path, hz):
    import rospy

    cls = get_message_class(name)
    message = cls()
    with open(path, "rb") as source:
        message.deserialize(source.read())
    rospy.init_node("messages", anonymous=True, disable_signals=True)
    publisher = rospy.Publisher(topic, cls, queue_size=2)
    print("publishing", flush=True)
    rate = rospy.Rate(hz)
    while True:
        publisher.publish(message)
        rate.sleep()


if __name__ == "__main__":
    verb, arguments = sys.argv[1], sys.argv[2:]
    arguments = [int(word) if word.isdigit() else word for word in arguments]
    {"make": make, "bag": bag, "compare": compare, "image": image, "array": array, "publish": publish}[verb](*arguments)
