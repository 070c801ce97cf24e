"""Writes what the tests of ROS 2 messages compare with: every type of ROS 2 Jazzy with its hash, and messages of random
values, all by rosbags; a few messages in the second version of CDR by Cyclone DDS; a recording by mcap-ros2-support.

    python3 -m venv peers && peers/bin/pip install rosbags==0.11.9 cyclonedds==11.0.1 mcap-ros2-support==0.6.0
    peers/bin/python tests/peers/ros2_messages.py

The files are committed, so that the tests need none of this. The same numbers come out each time.
"""

import base64
import json
import random
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore, store

ROOT = Path(__file__).resolve().parents[2]
MESSAGES = ROOT / "src/ros/message/ros2/jazzy.json"
RECORDING = ROOT / "tests/support/ros2.mcap"
STORE = get_typestore(Stores.ROS2_JAZZY)
# rosbags hashes a char as a type of its own; ROS 2 itself as a uint8, as shown by the hash that every node announces
# for rmw_dds_common/msg/ParticipantEntitiesInfo (RIHS01_91a0593b...).
store.TIDMAP["char"] = store.TIDMAP["uint8"]
BITS = {"int8": 8, "int16": 16, "int32": 32, "int64": 64, "uint8": 8, "uint16": 16, "uint32": 32, "uint64": 64}
TEXTS = ["", "a", "base_link", "é机器人", "quote\" and \\ back", "x" * 13]


def plain(name, limit, dice):
    if name == "bool":
        return dice.random() < 0.5
    if name == "string":
        return dice.choice(TEXTS)[: limit or None]
    if name == "float32":
        return float(numpy.float32(dice.choice([dice.uniform(-9, 9), 0.5, float("nan"), float("-inf")])))
    if name == "float64":
        return dice.choice([dice.randrange(-4096, 4096) / 64, 0.1, float("inf")])
    if name in ("byte", "char"):
        return dice.randrange(128)  # rosbags treats a byte as a signed number
    width, low = BITS[name], -(1 << BITS[name] - 1) if name.startswith("int") else 0
    return dice.choice([low, low + (1 << width) - 1, dice.randrange(100)])


def value(desc, dice):
    kind, rest = desc
    if kind == Nodetype.BASE:
        return plain(rest[0], rest[1], dice)
    if kind == Nodetype.NAME:
        return message(rest, dice)
    element, size = rest
    count = size if kind == Nodetype.ARRAY else dice.randrange(0, min(size or 4, 4))
    items = [value(element, dice) for _ in range(count)]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        kinds = {"byte": "uint8", "char": "uint8"}
        return numpy.array(items, dtype=kinds.get(element[1][0], element[1][0]))
    return items


def message(name, dice):
    fields = STORE.get_msgdef(name).fields
    return STORE.types[name](**{field: value(desc, dice) for field, desc in fields})


def tree(thing):
    """What rosbags decoded, as JSON has it; numbers that JSON lacks as texts."""
    if hasattr(thing, "__msgtype__"):
        names = [name for name, _ in STORE.get_msgdef(thing.__msgtype__).fields]
        names = [name for name in names if name != "structure_needs_at_least_one_member"]
        return {name: tree(getattr(thing, name)) for name in names}
    if isinstance(thing, numpy.ndarray):
        return [tree(item) for item in thing.tolist()]
    if isinstance(thing, list):
        return [tree(item) for item in thing]
    if isinstance(thing, float) and (thing != thing or thing in (float("inf"), float("-inf"))):
        return {"nan": "NaN"}.get(str(thing), str(thing))
    return thing


def own_text(name):
    return STORE.gendefhash(name, {}, 2)[0]


def samples(name):
    for number, little in enumerate((True, False)):
        dice = random.Random(f"{name} {number}")
        body = bytes(STORE.serialize_cdr(message(name, dice), name, little_endian=little))
        yield {"body": base64.b64encode(body).decode(), "value": tree(STORE.deserialize_cdr(body, name))}


def types():
    for name in sorted(STORE.fielddefs):
        text, digest = own_text(name), STORE.hash_rihs01(name)
        yield {"name": name, "text": text, "hash": digest, "samples": list(samples(name))}


def second_version():
    """The same values in the first and the second version of CDR, in both orders of bytes."""
    from cyclonedds._clayer import ddspy_calc_key  # noqa: F401  the wheel has its C library
    from cyclonedds.core import Entity  # noqa: F401
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl._support import Endianness
    from cyclonedds.idl.annotations import appendable, final
    from cyclonedds.idl.types import array, float64, int8, int64, sequence, uint8, uint16

    def declared(extensibility, kind):
        @dataclass
        @extensibility
        class Part(IdlStruct, typename=f"a.{kind}Part"):
            small: uint8
            large: float64
            names: sequence[str]

        @dataclass
        @extensibility
        class Root(IdlStruct, typename=f"a.{kind}Root"):
            flag: bool
            stamp: int64
            text: str
            parts: sequence[Part]
            pair: array[Part, 2]
            numbers: sequence[float64]
            bytes_: sequence[uint8]
            shorts: array[uint16, 3]
            last: int8

        part = lambda number: Part(number, number / 4, ["n" * number, "", "é"][:number])
        return Root(True, -(1 << 40), "robot", [part(1), part(2)], [part(3), part(0)], [0.5, -8.25], [1, 2, 3], [7, 8, 65535], -9)

    text = (
        "bool flag\nint64 stamp\nstring text\nPart[] parts\nPart[2] pair\nfloat64[] numbers\nuint8[] bytes_\n"
        "uint16[3] shorts\nint8 last\n" + "=" * 80 + "\nMSG: a/Part\nuint8 small\nfloat64 large\nstring[] names\n"
    )
    bodies = []
    for extensibility, kind in ((final, "final"), (appendable, "appendable")):
        root = declared(extensibility, kind)
        for second in (False, True):
            for order in (Endianness.Little, Endianness.Big):
                body = root.serialize(use_version_2=second, endianness=order)
                bodies.append({"about": f"{kind} {2 if second else 1} {order.name}", "body": base64.b64encode(body).decode()})
    part = lambda number: {"small": number, "large": number / 4, "names": ["n" * number, "", "é"][:number]}
    value = {
        "flag": True, "stamp": -(1 << 40), "text": "robot", "parts": [part(1), part(2)], "pair": [part(3), part(0)],
        "numbers": [0.5, -8.25], "bytes_": [1, 2, 3], "shorts": [7, 8, 65535], "last": -9,
    }
    return {"name": "a/msg/Root", "text": text, "bodies": bodies, "value": value}


def write_messages():
    lines = [json.dumps(entry, ensure_ascii=False, separators=(",", ":")) for entry in types()]
    second = json.dumps(second_version(), ensure_ascii=False, separators=(",", ":"))
    MESSAGES.write_text('{"types":[\n' + ",\n".join(lines) + '\n],"second_version":' + second + "}\n")


def write_recording():
    from mcap_ros2.writer import Writer

    def text_of(name):
        return STORE.generate_msgdef(name, 2)[0]

    with RECORDING.open("wb") as file:
        writer = Writer(file)
        names = {
            "/scan": "sensor_msgs/msg/LaserScan", "/odom": "nav_msgs/msg/Odometry", "/camera": "sensor_msgs/msg/Image",
            "/tf_static": "tf2_msgs/msg/TFMessage", "/chatter": "std_msgs/msg/String",
        }
        schemas = {topic: writer.register_msgdef(name, text_of(name)) for topic, name in names.items()}
        header = {"stamp": {"sec": 1_700_000_000, "nanosec": 5}, "frame_id": "base_link"}
        quaternion = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        pose = {"position": {"x": 1.5, "y": -2.25, "z": 0.0}, "orientation": quaternion}
        vector = {"x": 0.5, "y": 0.0, "z": 0.0}
        messages = {
            "/scan": {
                "header": header, "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.01, "time_increment": 0.0,
                "scan_time": 0.1, "range_min": 0.1, "range_max": 10.0, "ranges": [1.0 + step / 100 for step in range(200)],
                "intensities": [],
            },
            "/odom": {
                "header": header, "child_frame_id": "wheel", "pose": {"pose": pose, "covariance": [0.25] * 36},
                "twist": {"twist": {"linear": vector, "angular": vector}, "covariance": [0.0] * 36},
            },
            "/camera": {
                "header": header, "height": 8, "width": 12, "encoding": "rgb8", "is_bigendian": 0, "step": 36,
                "data": bytes(number % 251 for number in range(288)),
            },
            "/tf_static": {"transforms": [{
                "header": header, "child_frame_id": "laser", "transform": {"translation": vector, "rotation": quaternion},
            }]},
            "/chatter": {"data": "hello from ROS 2"},
        }
        for number, (topic, body) in enumerate(messages.items()):
            at = 1_700_000_000_000_000_000 + number * 1_000_000
            writer.write_message(topic, schemas[topic], body, log_time=at, publish_time=at - 777, sequence=40 + number)
        write_described(writer._writer)
        writer.finish()


def write_described(writer):
    """Two channels of which a recorder says what it knows; the type of one is described in IDL."""
    qos = "- history: keep_last\n  depth: 1\n  reliability: reliable\n  durability: transient_local\n"
    name = "std_msgs/msg/String"
    about = {"offered_qos_profiles": qos, "topic_type_hash": STORE.hash_rihs01(name)}
    idl = "module std_msgs {\n  module msg {\n    struct String {\n      string data;\n    };\n  };\n};\n"
    for number, (topic, encoding, text) in enumerate((("/latched", "ros2msg", own_text(name)), ("/idl", "ros2idl", idl))):
        schema = writer.register_schema(name, encoding, text.encode())
        channel = writer.register_channel(topic, "cdr", schema, about)
        body = bytes(STORE.serialize_cdr(STORE.types[name](data=f"kept {topic}"), name))
        at = 1_700_000_001_000_000_000 + number
        writer.add_message(channel, log_time=at, publish_time=at - 3, sequence=7 + number, data=body)


if __name__ == "__main__":
    write_messages()
    write_recording()
    print(MESSAGES.stat().st_size, RECORDING.stat().st_size, file=sys.stderr)
