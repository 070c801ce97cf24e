"""A ROS 1 node that publishes at a constant rate, for the scripts beside it: XML-RPC and TCPROS by the standard library.

Messages are sensor_msgs/CompressedImage of a given size with random data, in turn on each topic, over loopback only.
"""

import os
import socket
import struct
import threading
import time
import xmlrpc.client
from xmlrpc.server import SimpleXMLRPCServer

TYPE = "sensor_msgs/CompressedImage"
MD5 = "8f7a12909da2c9d3332d540a0977563f"
HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
DEFINITION = f"std_msgs/Header header\nstring format\nuint8[] data\n{'=' * 80}\nMSG: std_msgs/Header\n{HEADER}"
HOST = "127.0.0.1"


def text(value):
    return struct.pack("<I", len(value)) + value


def message(number, size):
    """A message of that many bytes."""
    now = time.time()
    head = struct.pack("<III", number, int(now), int(now % 1 * 1e9)) + text(b"load") + text(b"jpeg")
    return head + text(os.urandom(max(0, size - len(head) - 4)))


def read_exactly(stream, count):
    got = b""
    while len(got) < count:
        more = stream.recv(count - len(got))
        if not more:
            raise ConnectionError("the subscriber has gone")
        got += more
    return got


class Load:
    """The node. Subscribers are counted; `run` publishes until `end` is called."""

    def __init__(self, master, topics, size):
        self.topics, self.size, self.name = topics, size, "/load"
        self.sent, self.stopping = 0, threading.Event()
        self.lock, self.streams = threading.Lock(), {topic: [] for topic in topics}
        self.door = socket.create_server((HOST, 0))
        self.slave = SimpleXMLRPCServer((HOST, 0), logRequests=False, allow_none=True)
        self.slave.register_function(self.request_topic, "requestTopic")
        for work in (self.slave.serve_forever, self.accept):
            threading.Thread(target=work, daemon=True).start()
        self.url = f"http://{HOST}:{self.slave.server_address[1]}/"
        self.master = xmlrpc.client.ServerProxy(master)
        for topic in topics:
            code, why, _ = self.master.registerPublisher(self.name, topic, TYPE, self.url)
            if code != 1:
                raise RuntimeError(f"the master refuses {topic}: {why}")

    def request_topic(self, _caller, topic, _protocols):
        if topic not in self.streams:
            return [0, f"{topic} is not published here", 0]
        return [1, "ready", ["TCPROS", HOST, self.door.getsockname()[1]]]

    def accept(self):
        while True:
            try:
                stream, _ = self.door.accept()
            except OSError:
                return
            threading.Thread(target=self.greet, args=(stream,), daemon=True).start()

    def greet(self, stream):
        rest, topic = read_exactly(stream, struct.unpack("<I", read_exactly(stream, 4))[0]), None
        while rest:
            length = struct.unpack("<I", rest[:4])[0]
            name, _, value = rest[4 : 4 + length].partition(b"=")
            topic = value.decode() if name == b"topic" else topic
            rest = rest[4 + length :]
        if topic not in self.streams:
            stream.close()
            return
        about = {"callerid": self.name, "md5sum": MD5, "type": TYPE, "message_definition": DEFINITION, "topic": topic}
        stream.sendall(text(b"".join(text(f"{name}={value}".encode()) for name, value in about.items())))
        with self.lock:
            self.streams[topic].append(stream)

    def await_subscribers(self, seconds=30):
        end = time.monotonic() + seconds
        while not all(self.streams.values()):
            if time.monotonic() > end:
                raise TimeoutError("not every topic has a subscriber; is it watched?")
            time.sleep(0.05)

    def run(self, rate, most=None):
        """Publishes `most` messages, or until `end`. What a pause of the machine delays is sent after it."""
        due = time.monotonic()
        while not self.stopping.is_set() and self.sent != most:
            number, place = divmod(self.sent, len(self.topics))
            body = text(message(number, self.size))
            with self.lock:
                streams = list(self.streams[self.topics[place]])
            for stream in streams:
                stream.sendall(body)
            self.sent += 1
            due += 1 / rate
            time.sleep(max(0.0, due - time.monotonic()))

    def end(self):
        self.stopping.set()
        for topic in self.topics:
            try:
                self.master.unregisterPublisher(self.name, topic, self.url)
            except OSError:
                pass
        self.slave.shutdown()
        self.slave.server_close()
        self.door.close()
        for stream in sum(self.streams.values(), []):
            stream.close()
