#!/usr/bin/env python3
"""A running site in figures, under a load from a ROS node of its own:

    python3 tools/site_figures.py memory PROGRAM [--for 1h]   # memory at 1,000 messages a second, every ten seconds
    python3 tools/site_figures.py disk PROGRAM                # the store's bytes a record over its ciphertext
    python3 tools/site_figures.py cache PROGRAM               # `records open` with Redis and without; its hit rate

PROGRAM is an `authros`; its home is a temporary folder (TMPDIR), Redis a redis-server on a free port, and nothing leaves
loopback. The last line of the output is JSON. Each opening is an entry of the audit log, so it waits for an fsync: with
TMPDIR in memory (/dev/shm), `cache` shows what is left without it.
"""

import argparse
import json
import os
import random
import re
import shutil
import signal
import socket
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time

from line_figures import end, seconds, table
from ros_load import HOST, Load

MEBIBYTE = 1_048_576
TICKS = os.sysconf("SC_CLK_TCK")
# How long what was published may take to be verified, seconds.
REST = 180


class Site:
    """A home with an owner and a reader, served or not."""

    def __init__(self, program, folder):
        self.home, self.folder, self.running = os.path.join(folder, "home"), folder, None
        self.words = [os.path.abspath(program), "--home", self.home, "--robots", "0"]
        self.environment = {"HOME": folder, "PATH": os.environ["PATH"], "AUTHROS_STORE_PASSPHRASE": "yes"}

    def serve(self, *options):
        self.running = subprocess.Popen(
            [*self.words, *options, "serve"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=self.environment,
        )
        # Commands before the socket is there would be sites of their own.
        self.until("the site serves", lambda: self.connects())

    def connects(self):
        if self.running.poll() is not None:
            sys.exit(f"{self.words[0]} serve ended with {self.running.returncode}")
        with socket.socket(socket.AF_UNIX) as stream:
            return stream.connect_ex(self.socket) == 0

    @property
    def socket(self):
        return os.path.join(self.home, "site.sock")

    def run(self, *words):
        done = subprocess.run(
            [*self.words, "--json", *words], capture_output=True, text=True, env=self.environment, timeout=REST
        )
        if done.returncode:
            sys.exit(f"{' '.join(words)}: {done.stderr.strip() or done.stdout.strip()}")
        return done.stdout

    def status(self):
        return json.loads(self.run("status"))

    def until(self, what, is_so, bound=REST):
        over = time.monotonic() + bound
        while not is_so():
            if time.monotonic() > over:
                sys.exit(f"not after {bound} s: {what}")
            time.sleep(0.2)

    def load(self, topics, size):
        """A node whose topics this site watches."""
        part = next(part for part in self.status()["health"] if part["part"] == "ros")
        load = Load(re.search(r"http://[^ ,]+", part["text"])[0], topics, size)
        for topic in topics:
            self.run("topics", "watch", topic)
        load.await_subscribers()
        return load

    def settle(self, load):
        """The counts once all that was published is verified."""
        life = {}

        def is_verified():
            life.update(self.status()["life"])
            return life["captured"] >= load.sent and life["pending"] == 0

        self.until("all that was published is verified", is_verified)
        return life

    def end(self):
        if self.running:
            end(self.running)
            self.running = None


def memory_of(process):
    """Resident bytes, and those of them without a file behind them."""
    with open(f"/proc/{process}/status", encoding="utf-8") as file:
        fields = dict(line.split(":", 1) for line in file if ":" in line)
    return [int(fields[name].split()[0]) * 1024 for name in ("VmRSS", "RssAnon")]


def processor_of(process):
    with open(f"/proc/{process}/stat", encoding="utf-8") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def slope(points):
    """Of the line fitted to (minute, bytes) points: bytes a minute."""
    if len(points) < 3:
        return 0.0
    return statistics.linear_regression([at for at, _ in points], [value for _, value in points]).slope


def memory(arguments, site):
    site.run("identity", "register")
    site.serve()
    load = site.load([f"/load{number}/data" for number in range(1, arguments.topics + 1)], arguments.bytes)
    sender = threading.Thread(target=load.run, args=(arguments.rate,), daemon=True)
    process, samples = site.running.pid, []
    spent, begun = processor_of(process), time.monotonic()
    sender.start()
    while (gone := time.monotonic() - begun) < arguments.length:
        if not sender.is_alive():
            sys.exit("the load ended: the site has closed its connections")
        samples.append((gone / 60, *memory_of(process)))
        if len(samples) % arguments.shown == 1:
            resident, anonymous = (value / MEBIBYTE for value in samples[-1][1:])
            print(f"{gone / 60:6.1f} min  {resident:8.2f} MiB resident  {anonymous:8.2f} without a file", flush=True)
        time.sleep(min(arguments.every, max(0.0, arguments.length - (time.monotonic() - begun))))
    spent, lasted = processor_of(process) - spent, time.monotonic() - begun
    load.stopping.set()
    sender.join()
    life = site.settle(load)
    load.end()
    last = samples[len(samples) * 2 // 3 :]
    found = {
        "seconds": lasted,
        "published": load.sent,
        "per_second": load.sent / lasted,
        "verified": life["verified"],
        "dropped": life["dropped"],
        "conserved": life["conserved"],
        "cores": spent / lasted,
        "samples": samples,
    }
    rows = []
    for place, name in ((1, "resident"), (2, "without a file")):
        values = [sample[place] for sample in last]
        grown = slope([(sample[0], sample[place]) for sample in last])
        found[name] = {"spread": max(values) - min(values), "slope": grown}
        mebibytes = [value / MEBIBYTE for value in (samples[0][place], values[0], values[-1], max(values) - min(values))]
        rows.append([name, *(f"{value:.2f}" for value in mebibytes), f"{grown / MEBIBYTE:+.4f}"])
    print(table(["MiB", "at first", "at two thirds", "at last", "spread of the last third", "slope a minute"], rows))
    print(f"{load.sent} published, {life['verified']} verified, {life['dropped']} dropped; {found['cores']:.2f} cores")
    return found


def stored(home):
    """Bytes of the store's files, of its ciphertext, and records with one."""
    names = [name for name in os.listdir(home) if re.fullmatch(r"ledger\.db(-wal)?", name)]
    files = sum(os.path.getsize(os.path.join(home, name)) for name in names)
    with sqlite3.connect(f"file:{os.path.join(home, 'ledger.db')}?mode=ro", uri=True) as base:
        count, total = base.execute("SELECT count(*), coalesce(sum(length(bytes)), 0) FROM ciphertext").fetchone()
        free, page = (base.execute(f"PRAGMA {name}").fetchone()[0] for name in ("freelist_count", "page_size"))
    base.close()
    chain = sum(os.path.getsize(entry.path) for entry in os.scandir(os.path.join(home, "chain")))
    return {"files": files, "ciphertext": total, "records": count, "free": free * page, "chain": chain}


def disk(arguments, site):
    site.run("identity", "register")
    site.serve()
    # Watched before: names and tables are there already.
    topics = [f"/load{number}/data" for number in range(1, arguments.topics + 1)]
    load = site.load(topics, arguments.bytes)
    load.run(arguments.rate, arguments.topics)
    site.settle(load)
    load.end()
    site.end()
    before = stored(site.home)
    site.serve()
    load = site.load(topics, arguments.bytes)
    load.run(arguments.rate, arguments.records)
    site.until("all is verified", lambda: site.status()["life"]["verified"] >= arguments.topics + arguments.records)
    load.end()
    # Ended well, so that the log is in the file.
    site.end()
    after = stored(site.home)
    more = {name: after[name] - before[name] for name in after}
    each = {name: more[name] / more["records"] for name in ("files", "ciphertext", "chain")}
    ratio = each["files"] / each["ciphertext"]
    head = ["message", "records", "store, bytes each", "ciphertext", "ratio", "beside: chain, bytes each"]
    cells = [arguments.bytes, more["records"], f"{each['files']:.0f}", f"{each['ciphertext']:.0f}", f"{ratio:.3f}"]
    print(table(head, [[*cells, f"{each['chain']:.0f}"]]))
    if more["free"] > 0:
        print(f"of the store {more['free']} bytes are free pages")
    return {"bytes": arguments.bytes, "ratio": ratio, "each": each, "more": more}


class Redis:
    """A redis-server that keeps nothing."""

    def __init__(self, folder):
        program = shutil.which("redis-server")
        if not program:
            sys.exit("no redis-server; install the Debian package redis-server")
        with socket.create_server((HOST, 0)) as door:
            self.port = door.getsockname()[1]
        words = [program, "--bind", HOST, "--port", str(self.port), "--save", "", "--appendonly", "no", "--dir", folder]
        self.running = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.url = f"redis://{HOST}:{self.port}"
        over = time.monotonic() + 30
        while not self.answers():
            if time.monotonic() > over or self.running.poll() is not None:
                sys.exit("redis-server does not start")
            time.sleep(0.05)

    def answers(self):
        try:
            return self.ask("PING") == "+PONG"
        except OSError:
            return False

    def ask(self, words):
        with socket.create_connection((HOST, self.port), timeout=5) as stream:
            stream.sendall(f"{words}\r\n".encode())
            return stream.makefile().readline().strip()

    def count(self):
        return int(self.ask("DBSIZE").lstrip(":"))


class Reader:
    """A profile at the site's own socket: what `records open` asks, without the start of a process."""

    def __init__(self, site, profile):
        self.stream, self.profile, self.number = socket.socket(socket.AF_UNIX), profile, 0
        self.stream.connect(site.socket)
        self.lines = self.stream.makefile("rb")
        if "greeting" not in json.loads(self.lines.readline()):
            sys.exit("the site's socket greets in another way; this script is of another version")
        with open(os.path.join(site.home, "profiles", profile, "passphrase"), encoding="utf-8") as file:
            self.ask({"command": "unlock", "passphrase": file.readline().strip()})

    def ask(self, command):
        self.number += 1
        asked = {"number": self.number, "profile": self.profile, "command": command}
        self.stream.sendall(json.dumps(asked).encode() + b"\n")
        while True:
            answer = json.loads(self.lines.readline()).get("answer")
            if answer and answer["number"] == self.number:
                if "Ok" not in answer["with"]:
                    sys.exit(f"{command['command']}: {answer['with']}")
                return answer["with"]["Ok"]

    def close(self):
        self.lines.close()
        self.stream.close()


def opened(site, records, commands):
    """Milliseconds of each record at the socket, and of some as commands."""
    at_socket, as_command = [], []
    reader = Reader(site, "reader")
    for record in random.sample(records, len(records)):
        begun = time.perf_counter()
        reader.ask({"command": "open_shared", "id": record})
        at_socket.append((time.perf_counter() - begun) * 1000)
    reader.close()
    for record in random.sample(records, min(commands, len(records))):
        begun = time.perf_counter()
        site.run("--profile", "reader", "records", "open", record)
        as_command.append((time.perf_counter() - begun) * 1000)
    return at_socket, as_command


def passed(site, records, commands, name):
    """One pass over all records, with what the cache counted meanwhile."""

    def counts():
        cache = site.status().get("cache") or {}
        return [cache.get(part, 0) for part in ("hits", "misses", "wrong")]

    before = counts()
    at_socket, as_command = opened(site, records, commands)
    hits, misses, wrong = (now - then for now, then in zip(counts(), before))
    asked = hits + misses
    return {
        "pass": name,
        "median_ms": statistics.median(at_socket),
        "p95_ms": statistics.quantiles(at_socket, n=20)[18],
        "command_ms": statistics.median(as_command),
        "hits": hits,
        "misses": misses,
        "wrong": wrong,
        "hit_rate": hits / asked if asked else None,
    }


def cache(arguments, site):
    redis = Redis(site.folder)
    try:
        return cache_with(arguments, site, redis)
    finally:
        end(redis.running)


def cache_with(arguments, site, redis):
    site.run("identity", "register")
    reader = json.loads(site.run("--profile", "reader", "identity", "register"))["address"]
    site.run("grant", "add", reader)
    site.serve("--cache", redis.url)
    topics = [f"/load{number}/data" for number in range(1, arguments.topics + 1)]
    load = site.load(topics, arguments.bytes)
    load.run(arguments.rate, arguments.records)
    site.settle(load)
    load.end()
    for topic in topics:
        site.run("topics", "unwatch", topic)
    listed = json.loads(site.run("records", "list", "--oldest", "--limit", str(arguments.records)))
    records = [record["digest"] for record in listed["records"]]
    # Written after the commit, by a thread of its own.
    site.until("the cache has all records", lambda: redis.count() >= len(records))
    passes = [passed(site, records, arguments.commands, "written through")]
    for _ in range(arguments.rounds):
        redis.ask("FLUSHALL")
        passes.append(passed(site, records, arguments.commands, "flushed"))
        site.until("what was missed is in the cache", lambda: redis.count() >= len(records))
        passes.append(passed(site, records, arguments.commands, "filled"))
        site.end()
        site.serve()
        passes.append(passed(site, records, arguments.commands, "no cache"))
        site.end()
        site.serve("--cache", redis.url)
    rows, medians = [], {}
    for name in ("no cache", "flushed", "filled", "written through"):
        of = [one for one in passes if one["pass"] == name]
        # The least of the rounds: other work on the machine only adds.
        least = {figure: min(one[figure] for one in of) for figure in ("median_ms", "p95_ms", "command_ms")}
        hits, misses = (sum(one[part] for one in of) for part in ("hits", "misses"))
        share = f"{hits / (hits + misses) * 100:.1f} %" if hits + misses else "-"
        medians[name] = least["median_ms"]
        rows.append([name, share, *(f"{value:.2f}" for value in least.values())])
    print(table(["", "hits", "open, median ms", "p95 ms", "as a command, median ms"], rows))
    ratio = medians["filled"] / medians["no cache"]
    print(f"{len(records)} records of {arguments.bytes} bytes; a hit takes {ratio:.3f} times as long as no cache")
    wrong = sum(one["wrong"] for one in passes)
    return {"records": len(records), "bytes": arguments.bytes, "ratio": ratio, "wrong": wrong, "passes": passes}


def parsed():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ways = parser.add_subparsers(dest="way", required=True)
    ways = {name: ways.add_parser(name) for name in ("memory", "disk", "cache")}
    for name, size, rate in (("memory", 1_024, 1_000), ("disk", 749, 500), ("cache", 1_024, 200)):
        ways[name].add_argument("program")
        ways[name].add_argument("--bytes", type=int, default=size, help="of a message")
        ways[name].add_argument("--rate", type=float, default=rate, help="messages a second")
        ways[name].add_argument("--topics", type=int, default=4)
    ways["memory"].add_argument("--for", dest="length", type=seconds, default="15m")
    ways["memory"].add_argument("--every", type=float, default=10, help="seconds between two samples")
    ways["memory"].add_argument("--shown", type=int, default=6, help="samples for a line")
    ways["disk"].add_argument("--records", type=int, default=30_000)
    ways["cache"].add_argument("--records", type=int, default=500)
    ways["cache"].add_argument("--rounds", type=int, default=3)
    ways["cache"].add_argument("--commands", type=int, default=20, help="openings as commands in each pass")
    return parser.parse_args()


def main():
    arguments = parsed()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))
    print(f"load of the machine before: {os.getloadavg()[0]:.2f}", flush=True)
    with tempfile.TemporaryDirectory(prefix="authros-figures-", ignore_cleanup_errors=True) as folder:
        site = Site(arguments.program, folder)
        try:
            found = {"memory": memory, "disk": disk, "cache": cache}[arguments.way](arguments, site)
        finally:
            site.end()
    print(json.dumps({"way": arguments.way, **found}))


if __name__ == "__main__":
    main()
