"""Writes and reads recordings of rosbag2 with the package rosbags: `write FOLDER`, `read FOLDER`, `files FOLDER`."""
import json
import shutil
import sqlite3
import sys
import warnings
from itertools import count
from pathlib import Path

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

warnings.simplefilter("ignore")
STORE = get_typestore(Stores.ROS2_JAZZY)
START = 1_700_000_000_000_000_000
LONG = QosTime(9223372036, 854775807)
QOS = Qos(QosHistory.KEEP_LAST, 7, QosReliability.BEST_EFFORT, QosDurability.TRANSIENT_LOCAL, LONG, LONG,
          QosLiveliness.AUTOMATIC, LONG, False)
# What later versions added, by the version that did.
ADDED = {5: ["files"], 6: ["custom_data"], 8: ["ros_distro"]}


def one(path, plugin, mode, version, first, messages):
    with_text = STORE.types["std_msgs/msg/String"]
    writer = Writer(path, version=version, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        writer.set_custom_data("mission", 'the "harbour": east')
        topics = [writer.add_connection(topic, "std_msgs/msg/String", typestore=STORE, offered_qos_profiles=[QOS])
                  for topic in ("/left", "/right")]
        for number in range(first, first + messages):
            body = STORE.serialize_cdr(with_text(data=f"number {number}"), "std_msgs/msg/String")
            # Every other message comes late: parts overlap at their ends.
            late = 25 if number % 2 else 0
            writer.write(topics[number % 2], START + (number - late) * 1000, bytes(body))


def older(path, version):
    """Makes of a recording of version 8 one of an earlier version."""
    yaml = YAML(typ="safe")
    document = yaml.load(path.read_text())
    root = document["rosbag2_bagfile_information"]
    root["version"] = version
    for since, keys in ADDED.items():
        if version < since:
            for key in keys:
                root.pop(key, None)
    if version < 7:
        for topic in root["topics_with_message_count"]:
            topic["topic_metadata"].pop("type_description_hash")
    with path.open("w") as out:
        yaml.dump(document, out)


def older_schema(path):
    """The tables as before Iron."""
    database = sqlite3.connect(path)
    for table in ("schema", "metadata", "message_definitions"):
        database.execute(f"DROP TABLE {table}")
    database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    database.commit()
    database.close()


def split(path, plugin, mode, version, parts):
    """Several recordings made one, as rosbag2 splits it."""
    yaml = YAML(typ="safe")
    whole, names = None, []
    for part in range(parts):
        made = path.parent / f"{path.name}_{part}"
        one(made, plugin, mode, max(version, 8), part * 40, 40)
        root = yaml.load((made / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        path.mkdir(exist_ok=True)
        for name in root["relative_file_paths"]:
            shutil.move(made / name, path / name)
            # Before version 5 some had the folder's name in it.
            names.append(f"{path.name}/{name}" if version < 5 else name)
        shutil.rmtree(made)
        if whole is None:
            whole = root
        else:
            end = root["starting_time"]["nanoseconds_since_epoch"] + root["duration"]["nanoseconds"]
            whole["duration"]["nanoseconds"] = end - whole["starting_time"]["nanoseconds_since_epoch"]
            whole["message_count"] += root["message_count"]
            whole["files"] += root["files"]
            for mine, other in zip(whole["topics_with_message_count"], root["topics_with_message_count"]):
                mine["message_count"] += other["message_count"]
    whole["relative_file_paths"] = names
    with (path / "metadata.yaml").open("w") as out:
        yaml.dump({"rosbag2_bagfile_information": whole}, out)


def write(folder):
    for plugin in StoragePlugin:
        for mode in CompressionMode:
            if plugin is StoragePlugin.SQLITE3 and mode is CompressionMode.STORAGE:
                continue
            for version in (4, 5, 6, 7, 8, 9):
                for parts in (1, 3):
                    name = f"{plugin.name}_{mode.name}_{version}_{parts}".lower()
                    split(folder / name, plugin, mode, version, parts)
                    if version < 8:
                        older(folder / name / "metadata.yaml", version)
                    if version < 6 and plugin is StoragePlugin.SQLITE3 and mode is not CompressionMode.FILE:
                        for file in (folder / name).glob("*.db3"):
                            older_schema(file)


def messages(path):
    with Reader(path) as reader:
        found = [(c.topic, time, bytes(data).hex()) for c, time, data in reader.messages()]
        qos = {c.topic: repr(c.ext.offered_qos_profiles) for c in reader.connections}
        counts = {c.topic: c.msgcount for c in reader.connections}
        return {"messages": found, "qos": qos, "counts": counts}


def read(folder):
    for path in sorted(path for path in folder.iterdir() if path.is_dir()):
        print(json.dumps({"name": path.name, **messages(path)}))


def by_the_table(path):
    """Without the index, which another alteration may have met."""
    database = sqlite3.connect(f"file:{path}?immutable=1", uri=True)
    query = "SELECT name, timestamp, data FROM messages NOT INDEXED JOIN topics ON topics.id = topic_id"
    return [(topic, time, bytes(data).hex()) for topic, time, data in database.execute(query)]


def files(folder):
    for path in sorted(folder.glob("*.db3")):
        line = {"name": path.name, "index": None, "chunks": None}
        for way, how in (("index", lambda: messages(path)["messages"]), ("chunks", lambda: by_the_table(path))):
            try:
                line[way] = how()
            except Exception:
                pass
        print(json.dumps(line))


{"write": write, "read": read, "files": files}[sys.argv[1]](Path(sys.argv[2]))
