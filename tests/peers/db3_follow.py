"""Writes .db3 files into a folder as rosbag2's recorder with its sqlite3 storage does, and never waits for a lock.

usage: db3_follow.py FOLDER SECONDS RATE SPLIT_SECONDS

Each file is written in transactions that are held open for half a second; the next file is opened before the former is closed.
Whatever another process does with a file must not be noticed: a lock that is not to be had ends this with an error. What was
recorded is written to FOLDER.sent, a line a message: topic, time, SHA-256. Prints counts as one line of JSON.
"""

import hashlib
import json
import os
import sqlite3
import struct
import sys
import time

SCHEMA = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL,
                    offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
                                 encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
TOPICS = ["/numbers", "/robot1/words"]
HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def begin(path):
    database = sqlite3.connect(path, timeout=0, isolation_level=None)
    database.execute("PRAGMA journal_mode = MEMORY")
    database.execute("PRAGMA synchronous = OFF")
    database.executescript(SCHEMA)
    database.execute("INSERT INTO schema VALUES(4, 'kilted')")
    definition = ("std_msgs/msg/String", "ros2msg", "string data\n", HASH)
    database.execute("INSERT INTO message_definitions VALUES(1, ?, ?, ?, ?)", definition)
    for number, topic in enumerate(TOPICS, 1):
        database.execute("INSERT INTO topics VALUES(?, ?, 'std_msgs/msg/String', 'cdr', '', ?)", (number, topic, HASH))
    database.execute("BEGIN")
    return database


def end(database):
    database.execute("COMMIT")
    database.execute("INSERT INTO metadata VALUES(1, 9, 'version: 9')")
    database.close()


def main():
    folder, seconds, rate, split = sys.argv[1], float(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    os.mkdir(folder)
    name, total = os.path.basename(folder), int(seconds * rate)
    database, files, begun = None, 0, time.monotonic()
    split_at = held_since = begun
    with open(folder + ".sent", "w") as sent:
        for number in range(total):
            wait = begun + number / rate - time.monotonic()
            if wait > 0.002:
                time.sleep(wait)
            now = time.monotonic()
            if database is None or now - split_at >= split:
                former, database = database, begin(os.path.join(folder, f"{name}_{files}.db3"))
                if former is not None:
                    end(former)
                files, split_at, held_since = files + 1, now, now
            if now - held_since >= 0.5:
                database.execute("COMMIT")
                database.execute("BEGIN")
                held_since = now
            text = f"message {number} ".encode() + b"x" * (number % 900) + b"\0"
            data = b"\0\1\0\0" + struct.pack("<I", len(text)) + text
            topic, stamp = number % 2, 1_790_000_000_000_000_000 + number * 1_000_003
            database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", (topic + 1, stamp, data))
            sent.write(f"{TOPICS[topic]} {stamp} {hashlib.sha256(data).hexdigest()}\n")
    end(database)
    with open(os.path.join(folder, "metadata.yaml"), "w") as description:
        names = "".join(f"    - {name}_{number}.db3\n" for number in range(files))
        description.write(
            f"rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: sqlite3\n  relative_file_paths:\n{names}"
            f"  starting_time:\n    nanoseconds_since_epoch: 1790000000000000000\n  message_count: {total}\n"
        )
    print(json.dumps({"messages": total, "files": files}))


main()
