#!/usr/bin/env python3
"""Runs all tests of the workspace, several at a time, and says which took longest.

usage: tests/in_turn.py [WORD...]    only those whose name contains one of the words

A flow (tests/it, tests/attacks, labs/bench/tests/bench) is a process of its own, and so are all unit tests of a crate
and the checks of the contract. The longest begins first, by the seconds of the run before (target/tests.seconds, in a
fresh clone tests/longest.json). Of the flows that take `heavy()` three run at a time, so that none holds a place while it
waits for another. RUST_TEST_THREADS says how many places there are.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
TARGET = os.path.join(ROOT, "target")
SECONDS = os.path.join(TARGET, "tests.seconds")
# In a fresh clone the order comes from here: the longest of an earlier run, copied by hand when the set has changed much.
LONGEST_KNOWN = os.path.join(ROOT, "tests", "longest.json")
PLACES = int(os.environ.get("RUST_TEST_THREADS") or 2 * (os.cpu_count() or 1))
# Flows are run one by one; of the others, all tests of a program are one job, with this many threads.
FLOWS = ("it", "attacks", "bench")
THREADS = "2"
# How many flows that take `heavy()` run at a time; tests/support has as many locks.
HEAVY = 3
# How long something takes that never ran here.
UNKNOWN = {"flow": 5, "heavy flow": 15, "unit tests": 40, "checks": 90}
SLOWEST = 20
# Lines of each failed flow that are printed once more at the end, where a log is read first.
LAST_LINES = 100
# And of each failure its reason at the very end: this number of lines, of each this number of characters at its beginning and its end.
REASON_LINES, REASON_WIDTH = 8, 120
# Seconds between two reports of what is still running.
STILL = 300
# What runs for longer than this many seconds has failed: nothing in the ordinary set takes a tenth of it.
LONGEST = 3600 if os.environ.get("AUTHROS_LONG") else 1200


class Job:
    """One process: a flow, or all unit tests of a crate."""

    def __init__(self, name, command, folder, kind, known):
        self.name, self.command, self.folder = name, command, folder
        self.is_flow, self.is_heavy = kind.endswith("flow"), kind == "heavy flow"
        self.expected = known.get(name, UNKNOWN[kind])
        self.seconds = self.processor = 0.0

    def run(self):
        """Runs it to its end; returns what it printed and its exit status."""
        with tempfile.TemporaryFile() as output:
            begin = time.monotonic()
            process = subprocess.Popen(
                self.command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                env={**os.environ, "CARGO_MANIFEST_DIR": self.folder})
            end = threading.Timer(LONGEST, process.kill)
            end.start()
            # Counts its children too, if they were waited for.
            _, status, used = os.wait4(process.pid, 0)
            end.cancel()
            process.returncode = os.waitstatus_to_exitcode(status)
            self.seconds, self.processor = time.monotonic() - begin, used.ru_utime + used.ru_stime
            output.seek(0)
            return output.read().decode(errors="replace"), process.returncode


def programs():
    """The programs of all tests, built: name of the target, file, folder of the package."""
    build = ["cargo", "test", "--workspace", "--no-run", "--quiet", "--message-format=json"]
    built = subprocess.run(build, cwd=ROOT, stdout=subprocess.PIPE, check=False)
    if built.returncode != 0:
        sys.exit("the tests do not compile: cargo test --workspace --no-run")
    for line in built.stdout.splitlines():
        about = json.loads(line)
        if about["reason"] == "compiler-artifact" and about["profile"]["test"] and about["executable"]:
            yield about["target"]["name"], about["executable"], os.path.dirname(about["manifest_path"])


def heavy_flows(package, program):
    """Names of a program's flows whose source takes `heavy()`."""
    folder, names = os.path.join(package, "tests", program), set()
    for place, _, files in os.walk(folder):
        for file in files:
            path = os.path.relpath(os.path.join(place, file), folder)
            module = re.sub(r"(/mod)?\.rs$", "", path).replace("/", "::")
            with open(os.path.join(folder, path), encoding="utf-8") as source:
                text = source.read()
            for test in re.finditer(r"#\[test\]\s+fn (\w+)\(\) \{(.*?)^\}", text, re.MULTILINE | re.DOTALL):
                if "heavy()" in test[2]:
                    names.add(f"{module}::{test[1]}")
    return names


def jobs():
    """What is to run, the longest first; and the seconds known from earlier runs."""
    known = {}
    for path in (LONGEST_KNOWN, SECONDS):
        try:
            with open(path, encoding="utf-8") as file:
                known.update(json.load(file))
        except (OSError, ValueError):
            continue
    found = []
    for name, program, folder in programs():
        if name not in FLOWS:
            command = [program, "--show-output", "--test-threads", THREADS]
            package = "authros" if folder == ROOT else os.path.relpath(folder, ROOT)
            found.append(Job(f"{package}, {name}", command, folder, "unit tests", known))
            continue
        listed = subprocess.run([program, "--list", "--format", "terse"], stdout=subprocess.PIPE, check=True, text=True)
        heavy = heavy_flows(folder, name)
        for line in listed.stdout.splitlines():
            flow = line.removesuffix(": test")
            kind = "heavy flow" if flow in heavy else "flow"
            found.append(Job(flow, [program, "--exact", flow, "--show-output"], folder, kind, known))
    found.append(Job("contract", [os.path.join(ROOT, "contracts", "check")], ROOT, "checks", known))
    words = sys.argv[1:] or [""]
    wanted = [job for job in found if any(word in job.name for word in words)]
    return sorted(wanted, key=lambda job: -job.expected), known


def shortened(line):
    """A line without its middle, if it is long."""
    return line if len(line) <= 2 * REASON_WIDTH else f"{line[:REASON_WIDTH]} … {line[-REASON_WIDTH:]}"


def reasons(output):
    """The first lines of what each failed test of a program said, without the calls that led there."""
    _, _, failures = output.partition("\nfailures:\n")
    told = re.findall(r"^---- (.+) stdout ----\n(.*?)(?=^---- |^failures:|\Z)", failures, re.MULTILINE | re.DOTALL)
    for name, said in told:
        begin = max(said.find("panicked at"), 0)
        lines = said[begin:].partition("stack backtrace:")[0].strip().splitlines()
        yield name, [shortened(line) for line in lines[:REASON_LINES]]


class Turns:
    """Who is next, who runs, and what was found."""

    def __init__(self, waiting):
        self.waiting, self.running, self.ended, self.failed = waiting, [], [], False
        self.said, self.reasons = [], []
        self.sums, self.lock = [0, 0, 0], threading.Condition()

    def next(self):
        """The longest job that may begin, a heavy one before others: their row is the longest. None at the end."""
        with self.lock:
            while self.waiting:
                full = sum(job.is_heavy for job in self.running) >= HEAVY
                may = [job for job in self.waiting if not (job.is_heavy and full)]
                if may:
                    job = max(may, key=lambda job: job.is_heavy)
                    self.waiting.remove(job)
                    self.running.append(job)
                    return job
                self.lock.wait()
            return None

    def work(self):
        """What one place does."""
        while job := self.next():
            output, status = job.run()
            with self.lock:
                self.running.remove(job)
                self.ended.append(job)
                self.failed |= status != 0
                self.reasons += reasons(output) if status != 0 else []
                (self.tell_flow if job.is_flow else self.tell_program)(job, output, status)
                self.lock.notify_all()

    @staticmethod
    def tell_program(job, output, status):
        """Prints what a program with many tests printed; what ended it without its own sum is a failure more."""
        print(f"\n     Running {job.name} ({job.seconds:.1f} s)\n{output}", flush=True)
        if status != 0 and "test result: FAILED" not in output:
            print(f"{job.name} ended with {status}\ntest result: FAILED. 0 passed; 1 failed; 0 ignored", flush=True)

    def tell_flow(self, job, output, status):
        """Adds up the results of flows, and prints what they said themselves; everything of one that failed."""
        result = re.search(r"^test result: \w+\. (\d+) passed; (\d+) failed; (\d+) ignored.*$", output, re.MULTILINE)
        numbers = [int(number) for number in result.groups()] if result else [0, 1, 0]
        self.sums = [before + more for before, more in zip(self.sums, numbers)]
        if status != 0:
            said = output.replace(result[0], "") if result else output
            self.said.append((job.name, said.rstrip().splitlines()[-LAST_LINES:]))
            print(f"{said}\n{job.name} ended with {status} after {job.seconds:.1f} s\ntest {job.name} ... FAILED", flush=True)
            return
        for line in re.findall(r"^SKIPPED .+$", output, re.MULTILINE):
            print(line)
        said = re.search(r"^---- .+ stdout ----\n(.*?)\n+successes:\n", output, re.MULTILINE | re.DOTALL)
        print(f"test {job.name} ... ok ({job.seconds:.1f} s)" + (f"\n{said[1]}" if said else ""), flush=True)

    def report(self, seconds):
        """Prints what took longest, and the sum of the flows in cargo's words."""
        print(f"\nthe slowest of {len(self.ended)}: seconds, and seconds of the processor")
        for job in sorted(self.ended, key=lambda job: -job.seconds)[:SLOWEST]:
            print(f"{job.seconds:8.1f} {job.processor:7.1f}  {job.name}")
        heavy = [job for job in self.ended if job.is_heavy]
        for name, some in (("all", self.ended), ("the heavy ones", heavy)):
            print(f"{sum(job.seconds for job in some):8.1f} {sum(job.processor for job in some):7.1f}  {name}")
        for title, told in (("the last lines of", self.said), ("the reason of", self.reasons)):
            for name, lines in told:
                print("\n".join([f"\n{title} {name}", *(f"    {line}" for line in lines)]))
        passed, failed, ignored = self.sums
        verdict = "FAILED" if failed else "ok"
        print(f"test result: {verdict}. {passed} passed; {failed} failed; {ignored} ignored; all flows; "
              f"everything finished in {seconds:.2f}s", flush=True)


def main():
    waiting, known = jobs()
    begin, turns = time.monotonic(), Turns(waiting)
    places = [threading.Thread(target=turns.work, daemon=True) for _ in range(PLACES)]
    for place in places:
        place.start()
    for place in places:
        while place.is_alive():
            place.join(STILL)
            if place.is_alive():
                with turns.lock:
                    print("still running:", ", ".join(job.name for job in turns.running), flush=True)
    with open(SECONDS, "w", encoding="utf-8") as file:
        json.dump(known | {job.name: round(job.seconds, 1) for job in turns.ended}, file, indent=0, sort_keys=True)
    turns.report(time.monotonic() - begin)
    return int(turns.failed)


if __name__ == "__main__":
    sys.exit(main())
