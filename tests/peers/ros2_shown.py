"""Real messages of ROS 2 with values at the edges, and how they are shown.

`types [all]` prints types that are installed, one a line: those that ask most of a reader, or all.
`publish FOLDER SEED COUNT TYPE...` publishes COUNT messages of each type, latched, on `/shown/PACKAGE/TYPE`, and writes each as it was
serialised to FOLDER/PACKAGE.TYPE.N.cdr; prints `ready` when all were published, and stays.
`compare FOLDER` compares what was shown beside these files (`.json`: every field; `.view.json`: an opened record) and in
FOLDER/export.mcap (not compressed) with what rclpy reads; prints one line of JSON: the comparisons made and the first differences.
"""

import importlib
import json
import math
import pkgutil
import random
import struct
import sys
import time
from collections import defaultdict
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    BoundedString,
    BoundedWString,
    NamespacedType,
    UnboundedSequence,
)

# Beside all of test_msgs: of each package what has most kinds of fields.
FEW = """sensor_msgs/Imu sensor_msgs/LaserScan sensor_msgs/PointCloud2 sensor_msgs/JointState sensor_msgs/BatteryState sensor_msgs/CameraInfo
std_msgs/Float32MultiArray std_msgs/Byte std_msgs/Char std_msgs/Empty nav_msgs/Odometry geometry_msgs/TwistWithCovarianceStamped
builtin_interfaces/Time rcl_interfaces/ParameterEvent lifecycle_msgs/TransitionEvent action_msgs/GoalStatusArray rosgraph_msgs/Clock
diagnostic_msgs/DiagnosticArray visualization_msgs/InteractiveMarkerUpdate trajectory_msgs/MultiDOFJointTrajectory shape_msgs/Mesh
stereo_msgs/DisparityImage type_description_interfaces/TypeDescription unique_identifier_msgs/UUID service_msgs/ServiceEventInfo""".split()
TEXTS = ["", "a", "é漢😀", 'quoted "\\" \'', "line\nend\t.", "\x1b[31mred\x07", "\u202eback", "x" * 300, "_" * 12]
BITS = {"float": ("<f", 4), "double": ("<d", 8)}
EDGES = [0.0, -0.0, math.inf, -math.inf, math.nan, 1.0, 1 / 3, -943.3050469559873]
SINGLE = [1.401298464324817e-45, 1.1754942106924411e-38, 3.4028234663852886e38]
DOUBLE = [5e-324, 2.225073858507201e-308, 1.7976931348623157e308, 0.1]


def cls(name):
    package, type_name = name.split("/")
    return getattr(importlib.import_module(package + ".msg"), type_name)


def types(every):
    found = []
    for module in sorted(module.name for module in pkgutil.iter_modules()):
        if module.endswith(("_msgs", "_interfaces")):
            try:
                names = vars(importlib.import_module(module + ".msg"))
            except ModuleNotFoundError:
                continue
            found += [f"{module}/{name}" for name, kind in sorted(names.items()) if hasattr(kind, "get_fields_and_field_types")]
    return [name for name in found if every or name in FEW or name.startswith("test_msgs/")]


def integer(name, choose):
    bits = int(name.lstrip("uint"))
    least, most = (0, 2**bits - 1) if name[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return choose.choice([least, most, 0, choose.randint(least, most)])


def number(name, choose):
    if name == "boolean":
        return choose.random() < 0.5
    if name == "octet":
        return bytes([choose.randrange(256)])
    if name not in BITS:
        return integer(name, choose)
    form, size = BITS[name]
    [any_bits] = struct.unpack(form, choose.randbytes(size))
    return choose.choice(EDGES + (SINGLE if size == 4 else DOUBLE) + [any_bits] * 8)


def text(kind, choose):
    if isinstance(kind, (BoundedString, BoundedWString)):
        return choose.choice(["", "y" * kind.maximum_size, "z" * choose.randint(0, kind.maximum_size)])
    return choose.choice([one for one in TEXTS if isinstance(kind, AbstractString) or max(map(ord, one), default=0) < 0x10000])


def value(kind, choose):
    if isinstance(kind, BasicType):
        return number(kind.typename, choose)
    if isinstance(kind, (AbstractString, AbstractWString)):
        return text(kind, choose)
    if isinstance(kind, NamespacedType):
        return message(getattr(importlib.import_module(".".join(kind.namespaces)), kind.name), choose)
    if isinstance(kind, Array):
        count = kind.size
    else:
        most = kind.maximum_size if isinstance(kind, BoundedSequence) else 5
        count = choose.choice([0, 1, most, choose.randint(0, most)])
    return [value(kind.value_type, choose) for _ in range(count)]


def message(kind, choose):
    made = kind()
    for field, its_kind in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES):
        setattr(made, field, value(its_kind, choose))
    return made


def publish(folder, seed, count, names):
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    rclpy.init()
    node = rclpy.create_node("shown")
    choose = random.Random(seed)
    keep = QoSProfile(depth=count, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
    publishers, last = [], {}
    for name in names:
        kind = cls(name)
        publishers.append(node.create_publisher(kind, "/shown/" + name, keep))
        for place in range(count):
            sent = message(kind, choose)
            (folder / f"{name.replace('/', '.')}.{place}.cdr").write_bytes(serialize_message(sent))
            if place + 1 < count:
                publishers[-1].publish(sent)
            else:
                last[publishers[-1]] = [None, sent]
    # The last one comes when its publisher has been asked for its definition; those before it are read by that one too.
    def go_on():
        for publisher in list(last):
            since, sent = last[publisher]
            if since is None and publisher.get_subscription_count() > 0:
                last[publisher][0] = time.monotonic()
            elif since is not None and time.monotonic() - since > 15:
                publisher.publish(sent)
                del last[publisher]

    node.create_timer(0.2, go_on)
    print("ready", flush=True)
    # A node answers for its types only while it spins.
    rclpy.spin(node)


class Comparing:
    """Differences of what is shown from what rclpy reads."""

    def __init__(self):
        self.made, self.shortened, self.differences = defaultdict(int), 0, []

    def differ(self, way, where, wanted, found):
        self.differences.append(f"{way} {where}: {wanted!r}, not {found!r}")

    def plain(self, way, where, kind, wanted, found):
        """A number or a text."""
        self.made[way] += 1
        if isinstance(kind, (AbstractString, AbstractWString)):
            cleaned = way == "view" and (not wanted.isprintable() or len(wanted) > 100)
            equal = isinstance(found, str) and (cleaned or found == wanted)
        elif kind.typename in BITS:
            form, _ = BITS[kind.typename]
            shown = float(found) if isinstance(found, (str, int, float)) and not isinstance(found, bool) else None
            alike = shown is not None and math.isnan(wanted) == math.isnan(shown)
            # A NaN is shown as such, without its bits.
            equal = alike and (math.isnan(wanted) or struct.pack(form, wanted) == struct.pack(form, shown))
        else:
            wanted = wanted[0] if isinstance(wanted, bytes) else wanted
            equal = type(found) is type(wanted) and found == wanted
        if not equal:
            self.differ(way, where, wanted, found)

    def value(self, way, where, kind, wanted, found):
        if isinstance(kind, NamespacedType):
            return self.message(way, where, wanted, found)
        if not isinstance(kind, (Array, BoundedSequence, UnboundedSequence)):
            return self.plain(way, where, kind, wanted, found)
        if way == "view" and isinstance(found, str) and found.endswith(f"[{len(wanted)}]"):
            self.shortened += 1
            return None
        if not isinstance(found, list) or len(found) != len(wanted):
            return self.differ(way, where, f"{len(wanted)} elements", found)
        for place, (one, other) in enumerate(zip(wanted, found)):
            one = one.item() if hasattr(one, "item") else one
            self.value(way, f"{where}[{place}]", kind.value_type, one, other)
        return None

    def message(self, way, where, wanted, found):
        names = list(wanted.get_fields_and_field_types())
        if not isinstance(found, dict) or list(found) != names and sorted(found) != sorted(names):
            return self.differ(way, where, names, found)
        for name, kind in zip(names, wanted.SLOT_TYPES):
            self.value(way, f"{where}.{name}", kind, getattr(wanted, name), found[name])
        return None


def read_json(path):
    # "-0" would lose its sign as an integer.
    return json.loads(path.read_text(), parse_int=lambda digits: -0.0 if digits == "-0" else int(digits))


def records(content):
    """The records of MCAP, those in chunks too; chunks are not compressed."""
    place = 0
    while place + 9 <= len(content):
        code, length = struct.unpack_from("<BQ", content, place)
        body = content[place + 9 : place + 9 + length]
        place += 9 + length
        if code == 6:
            [skipped] = struct.unpack_from("<I", body, 28)
            yield from records(body[32 + skipped + 8 :])
        else:
            yield code, body


def word(body, place):
    [length] = struct.unpack_from("<I", body, place)
    return body[place + 4 : place + 4 + length].decode(), place + 4 + length


def exported(path):
    """The bodies by topic, in order."""
    topics, found = {}, defaultdict(list)
    for code, body in records(path.read_bytes()[8:-8]):
        if code == 4:
            topics[struct.unpack_from("<H", body)[0]] = word(body, 4)[0]
        elif code == 5:
            found[topics[struct.unpack_from("<H", body)[0]]].append(body[22:])
    return found


def bits(kind, read):
    """A message as bytes that say every bit of its values."""
    if isinstance(kind, NamespacedType):
        return b"".join(bits(its, getattr(read, name)) for name, its in zip(read.get_fields_and_field_types(), read.SLOT_TYPES))
    if isinstance(kind, (Array, BoundedSequence, UnboundedSequence)):
        return b"%d|" % len(read) + b"".join(bits(kind.value_type, one) for one in read)
    if isinstance(kind, BasicType) and kind.typename in BITS:
        return struct.pack(BITS[kind.typename][0], read)
    return repr(read.item() if hasattr(read, "item") else read).encode() + b"|"


def compare(folder):
    comparing, whole = Comparing(), NamespacedType([], "")
    recording = exported(folder / "export.mcap")
    for path in sorted(folder.glob("*.cdr")):
        package, type_name, place = path.stem.split(".")
        kind = cls(f"{package}/{type_name}")
        wanted = deserialize_message(path.read_bytes(), kind)
        if not path.with_suffix(".json").exists():
            comparing.differ("file", path.stem, "a file", None)
            continue
        comparing.message("file", path.stem, wanted, read_json(path.with_suffix(".json")))
        view = read_json(path.with_suffix(".view.json"))
        comparing.message("view", path.stem, wanted, view["message"])
        if view.get("note") is not None and "matches the message" not in view["note"]:
            comparing.differ("view", path.stem, "no doubt", view["note"])
        bodies = recording[f"/shown/{package}/{type_name}"]
        comparing.made["export"] += 1
        if len(bodies) <= int(place) or bits(whole, deserialize_message(bodies[int(place)], kind)) != bits(whole, wanted):
            comparing.differ("export", path.stem, "the same message", bodies[int(place) : int(place) + 1])
    said = [difference[:400] for difference in comparing.differences]
    print(json.dumps({"made": comparing.made, "shortened": comparing.shortened, "differ": len(said), "first": said[:20]}))


def main():
    act, *rest = sys.argv[1:]
    if act == "types":
        print("\n".join(types(rest == ["all"])))
    elif act == "publish":
        publish(Path(rest[0]), int(rest[1]), int(rest[2]), rest[3:])
    else:
        compare(Path(rest[0]))


main()
