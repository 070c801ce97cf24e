#!/usr/bin/env python3
"""What the console costs in a terminal, beside htop and btop in the same run, at 80x24 and 200x50:

    python3 tools/console_figures.py PROGRAM [SECONDS]

First frame, bytes for a cursor key, bytes a second while nothing changes and while 44 records a second come, and the
processor time of the console. A site of its own (`authros serve`, four simulated robots, four watched topics) makes the
records, so that the console's process has nothing but the console in it; a console that is the site itself is measured
thread by thread. Everything lies in a folder that is removed afterwards. Figures of a debug build say little about
processor time.
"""

import fcntl
import json
import os
import pty
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time

SIZES = [(80, 24), (200, 50)]
TOPICS = ["/robot1/odom", "/robot2/odom", "/robot1/camera/compressed", "/robot2/camera/compressed"]
# A screen has begun when this many bytes have come.
BEGUN = 400
# How long nothing comes after the answer to a key, seconds.
QUIET = 0.15
# Threads of the simulated robots and of their side of ROS.
ROBOTS = ("robot-", "ros-port", "ros-writer", "ros-master", "ros-slave", "ros-handshake")
# What the console must not exceed. At 200x50 a cursor key fills the pane beside the list too.
FRAME, IDLE, KEY, OVERVIEW, CPU = 100, 0.5, 200, 1_000, 2.0


class Terminal:
    """A program in a terminal of its own."""

    def __init__(self, words, size, home):
        self.begun, self.bytes, self.first, self.over = time.monotonic(), 0, None, False
        self.process, self.master = pty.fork()
        if self.process == 0:
            environment = {"TERM": "xterm-256color", "LANG": "C.UTF-8", "HOME": home, "PATH": os.environ["PATH"]}
            # The size is there before the program asks for it.
            fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
            os.execvpe(words[0], words, environment)
        self.lock = threading.Lock()
        self.last = self.begun
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        while not self.over:
            if not select.select([self.master], [], [], 0.2)[0]:
                continue
            try:
                got = os.read(self.master, 65536)
            except OSError:
                return
            if not got:
                return
            with self.lock:
                self.bytes += len(got)
                self.last = time.monotonic()
                if self.first is None and self.bytes >= BEGUN:
                    self.first = self.last

    def press(self, key):
        os.write(self.master, key.encode())
        self.settle()

    def settle(self):
        """Waits until nothing has come for a moment; a program that draws all the time is given a second."""
        end = time.monotonic() + 1
        time.sleep(QUIET)
        while time.monotonic() - self.last < QUIET and time.monotonic() < end:
            time.sleep(0.02)

    def frame(self):
        """Milliseconds from the start to the first screen."""
        end = time.monotonic() + 20
        while self.first is None and time.monotonic() < end:
            time.sleep(0.001)
        return (self.first - self.begun) * 1000 if self.first else float("inf")

    def end(self):
        try:
            os.kill(self.process, signal.SIGTERM)
            for _ in range(100):
                if os.waitpid(self.process, os.WNOHANG)[0]:
                    break
                time.sleep(0.05)
            else:
                os.kill(self.process, signal.SIGKILL)
                os.waitpid(self.process, 0)
        except (ProcessLookupError, ChildProcessError):
            pass
        self.over = True
        os.close(self.master)


def spent(process):
    """Processor seconds of each thread, by its name."""
    threads = {}
    for thread in os.listdir(f"/proc/{process}/task"):
        at = f"/proc/{process}/task/{thread}"
        try:
            with open(f"{at}/comm") as name, open(f"{at}/schedstat") as figures:
                threads[thread, name.read().strip()] = int(figures.read().split()[0]) / 1e9
        except (FileNotFoundError, ProcessLookupError):
            pass
    return threads


def parts(before, after):
    """Processor seconds of the console, the robots and the rest."""
    sums = {"console": 0.0, "robots": 0.0, "rest": 0.0}
    for thread, seconds in after.items():
        name = thread[1]
        part = "console" if name.startswith("console") or name == "authros" else "rest"
        part = "robots" if name.startswith(ROBOTS) else part
        sums[part] += seconds - before.get(thread, 0.0)
    return sums


def watched(terminals, seconds):
    """Bytes a second and percent of a core of each, over the same time."""
    before = [(one.bytes, spent(one.process)) for one in terminals]
    begun = time.monotonic()
    time.sleep(seconds)
    lasted = time.monotonic() - begun
    rows = []
    for one, (bytes_before, cpu_before) in zip(terminals, before):
        by_part = parts(cpu_before, spent(one.process))
        cpu = {part: share / lasted * 100 for part, share in by_part.items()}
        rows.append(((one.bytes - bytes_before) / lasted, sum(cpu.values()), cpu))
    return rows


class Site:
    """A home with two profiles, a grant and four watched topics; served, or opened by a console that is the site."""

    def __init__(self, program, folder, name):
        self.words = [program, "--home", os.path.join(folder, name), "--robots", "4"]
        self.environment, self.served = {"HOME": folder, "AUTHROS_STORE_PASSPHRASE": "yes"}, None
        other = json.loads(self.run("--profile", "other", "--json", "identity", "register"))["address"]
        self.run("identity", "register")
        for topic in TOPICS:
            self.run("topics", "watch", topic)
        self.run("grant", "add", other)

    def run(self, *words):
        done = subprocess.run(self.words + list(words), capture_output=True, text=True, env=self.environment)
        if done.returncode:
            sys.exit(f"{' '.join(words)}: {done.stderr}")
        return done.stdout

    def serve(self):
        self.served = subprocess.Popen(
            self.words + ["serve"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=self.environment
        )
        end = time.monotonic() + 60
        while self.rate() < 1 and time.monotonic() < end:
            time.sleep(1)

    def captured(self):
        return json.loads(self.run("--json", "status"))["life"]["captured"]

    def rate(self):
        """Records a second now."""
        before, begun = self.captured(), time.monotonic()
        time.sleep(1)
        return (self.captured() - before) / (time.monotonic() - begun)

    def end(self):
        if self.served:
            self.served.terminate()
            self.served.wait(60)


def measure(program, folder, seconds):
    others = [name for name in ("htop", "btop") if shutil.which(name)]
    empty = [program, "--home", os.path.join(folder, "idle"), "--robots", "0"]
    busy = Site(program, folder, "busy")
    rows = []

    def starts(words, size):
        took = []
        for _ in range(3):
            one = Terminal(words, size, folder)
            took.append(one.frame())
            time.sleep(0.3)
            one.end()
        return sorted(took)[1]

    def started(words, size, settle):
        all_words = [words] + [[name] for name in others]
        terminals = [Terminal(words, size, folder) for words in all_words]
        time.sleep(settle)
        return terminals

    def finish(terminals):
        for one in terminals:
            one.end()

    for size in SIZES:
        at = f"{size[0]}x{size[1]}"
        frames = [starts(words, size) for words in [empty] + [[name] for name in others]]
        rows.append((f"first frame, {at}, ms", FRAME, frames))
        terminals = started(empty, size, 8)
        idle = watched(terminals, seconds)
        rows.append((f"idle, {at}, B/s", IDLE, [row[0] for row in idle]))
        rows.append((f"idle, {at}, % of a core", CPU, [row[1] for row in idle]))
        finish(terminals)

    busy.serve()
    before, begun = busy.captured(), time.monotonic()
    joined = busy.words
    for size in SIZES:
        at = f"{size[0]}x{size[1]}"
        terminals = started(joined, size, 12)
        console = terminals[0]
        for key, screen in (("1", "Overview"), ("2", "Topics"), ("3", "Records")):
            console.press(key)
            time.sleep(2)
            found = watched(terminals, seconds)
            judged = screen == "Overview" and size == SIZES[0]
            rows.append((f"load, {screen}, {at}, B/s", OVERVIEW if judged else None, [row[0] for row in found]))
            rows.append((f"load, {screen}, {at}, % of a core", CPU if judged else None, [row[1] for row in found]))
        console.press("2")
        console.press("f")
        bytes_each = []
        for one, keys in zip(terminals, [("j", "k")] + [("\x1b[B", "\x1b[A")] * len(others)):
            one.press(keys[0])
            one.press(keys[1])
            start = one.bytes
            for press in range(20):
                one.press(keys[press % 2])
            bytes_each.append((one.bytes - start) / 20)
        rows.append((f"bytes a cursor key, {at}", KEY if size == SIZES[0] else None, bytes_each))
        finish(terminals)
    rate = (busy.captured() - before) / (time.monotonic() - begun)
    busy.end()

    # The console that is the site itself, on the Overview: its threads by what they work for.
    own = Terminal(busy.words, SIZES[0], folder)
    time.sleep(12)
    own.press("1")
    time.sleep(1)
    (_, _, by_part), = watched([own], seconds)
    own.end()
    rows.append(("as the site, % of a core: console", CPU, [by_part["console"]]))
    rows.append(("as the site, % of a core: robots", None, [by_part["robots"]]))
    rows.append(("as the site, % of a core: pipeline", None, [by_part["rest"]]))
    return others, rows, rate


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program, seconds = os.path.abspath(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 10.0
    with tempfile.TemporaryDirectory(prefix="authros-figures-") as folder:
        others, rows, rate = measure(program, folder, seconds)
    print(f"{'':44} {'at most':>8} {'authros':>9}" + "".join(f" {name:>9}" for name in others))
    over = 0
    for what, most, values in rows:
        limit = "" if most is None else f"{most:,.0f}" if most >= 1 else "0"
        broken = most is not None and values[0] > most
        over += broken
        cells = "".join(f" {value:9.1f}" for value in values)
        print(f"{what:44} {limit:>8}{cells}{'  OVER' if broken else ''}")
    print(f"{rate:.1f} records a second came during the load; load of the machine {os.getloadavg()[0]:.1f}")
    sys.exit(1 if over else 0)


if __name__ == "__main__":
    main()
