#!/usr/bin/env python3
"""The whole line, from publisher to verified, in figures that are compared:

    python3 tools/line_figures.py compare BENCH REFERENCE   # processor a message and throughput of two builds, in turns
    python3 tools/line_figures.py rate BENCH                # a rate for five minutes on a full store, then the highest

BENCH and REFERENCE are programs that have the bench `pipeline`: an `authros-bench`, or an older `authros` whose `bench`
is a command of its own. The figures are the bench's: processor time is that of its whole process, publishers included,
which dilutes a ratio a little. The last line of the output is JSON.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time

# A rate is held if at least this share of it arrives, nothing is lost, the law holds, and p99 to verified is within.
HELD, WITHIN = 0.98, 2_000.0
# The lowest rate that is tried where higher ones are not held.
LOWEST = 600
# What the bench waits for after a load, its start and its end, seconds.
AROUND = 240


def seconds(text):
    units = {"s": 1, "m": 60, "h": 3600}
    if text[-1:] not in units or not text[:-1].isdigit():
        raise argparse.ArgumentTypeError(f"{text} is not a time such as 20s or 5m")
    return int(text[:-1]) * units[text[-1]]


def table(head, rows):
    cells = [[str(cell) for cell in row] for row in [head, *rows]]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(row, widths)) for row in cells)


class Program:
    """One build; found out by its help, it is called in its own way."""

    def __init__(self, path, folder):
        self.path, self.folder = os.path.abspath(path), folder
        self.environment = {"HOME": folder, "PATH": os.environ["PATH"], "TMPDIR": folder}
        ways = [words for words in (["pipeline"], ["bench", "pipeline"]) if self.ends_well([*words, "--help"])]
        if not ways:
            sys.exit(f"{path} has no bench 'pipeline'; give an authros-bench, or an authros with the command bench")
        self.words = ways[0]

    def ends_well(self, words):
        done = subprocess.run([self.path, *words], capture_output=True, env=self.environment, timeout=60)
        return done.returncode == 0

    def pipeline(self, rate, publishers, length, before=0):
        """The bench's document; None if it ended without one."""
        load = ["--load", "messages", "--rate", str(rate), "--publishers", str(publishers), "--for", f"{length}s"]
        load += ["--before", str(before)] if before else []
        out = os.path.join(self.folder, "out")
        is_own = self.words[0] == "pipeline"
        words = ["--out", out, *self.words] if is_own else ["--json", *self.words]
        # A thousand records put there before take a second at most.
        bound = AROUND + length + before // 1000
        output = self.bounded([self.path, *words, *load], bound)
        if output is None:
            return None
        if is_own:
            with open(os.path.join(out, "pipeline.json"), encoding="utf-8") as file:
                output = file.read()
        return json.loads(output)

    def bounded(self, words, bound):
        running = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self.environment
        )
        try:
            output, errors = running.communicate(timeout=bound)
        except subprocess.TimeoutExpired:
            errors = f"not done after {bound} s"
        finally:
            end(running)
        if running.returncode == 0:
            return output
        print(f"{os.path.basename(self.path)}: {errors.strip() or running.returncode}", file=sys.stderr)
        return None


def end(running):
    """SIGTERM lets the bench remove its folder."""
    if running.poll() is None:
        running.send_signal(signal.SIGTERM)
        try:
            running.wait(30)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()


def figures(document):
    """What is compared of one run."""
    (load,) = document["loads"]
    (verified,) = [row for row in document["results"] if row["milestone"] == "verified"]
    lost = load["lost_in_transport"] + load["dropped"]
    whole = lost == 0 and load["law_broken"] == 0 and load["tampered"] == 0
    return {
        "rate": load["asked_per_second"],
        "captured_per_second": load["per_second"],
        "published": load["published"],
        "verified": load["verified"],
        "lost": lost,
        "law_checked": load["law_asked"],
        "law_broken": load["law_broken"],
        "p50_ms": verified["p50"],
        "p99_ms": verified["p99"],
        "fsync_p50_ms": load["fsync_p50"],
        "fsync_p95_ms": load["fsync_p95"],
        "before": load["before"],
        "cores": load["cores"],
        "processor_us": load["cores"] * load["seconds"] / load["captured"] * 1e6,
        "throughput": load["verified"] / (load["seconds"] + load["rest_seconds"]),
        "pending_end": load["pending_end"],
        "held": whole and load["per_second"] >= HELD * load["asked_per_second"] and verified["p99"] <= WITHIN,
    }


def round_of(program, arguments):
    """A rate that every build holds, for the processor; one that none does, for the throughput."""
    held = program.pipeline(arguments.rate, arguments.publishers, arguments.length)
    flood = program.pipeline(arguments.flood, arguments.publishers, arguments.flood_length)
    if held is None or flood is None:
        return None
    held = figures(held)
    return {**held, "throughput": figures(flood)["throughput"]}


def compare(arguments, folder):
    programs = {name: Program(getattr(arguments, name), folder) for name in ("bench", "reference")}
    begun, rounds = time.monotonic(), []
    for number in range(arguments.rounds):
        # The one that is first is so in every second round only.
        for name in sorted(programs, reverse=number % 2 == 1):
            if time.monotonic() - begun > arguments.minutes * 60:
                break
            found = round_of(programs[name], arguments)
            if found:
                rounds.append({"build": name, "round": number + 1, **found})
                line(rounds[-1], name)
    of = {name: [one for one in rounds if one["build"] == name] for name in programs}
    if not all(of.values()):
        sys.exit("a build has no figures at all; see the lines above")
    least = {name: min(one["processor_us"] for one in found) for name, found in of.items()}
    most = {name: max(one["throughput"] for one in found) for name, found in of.items()}
    processor, throughput = least["bench"] / least["reference"], most["bench"] / most["reference"]
    head = ["", "rounds", "us a message, least", "verified/s, most", "lost at the held rate"]
    rows = [
        [name, len(of[name]), f"{least[name]:.1f}", f"{most[name]:.0f}", sum(one["lost"] for one in of[name])]
        for name in programs
    ]
    print(table(head, [*rows, ["ratio", "", f"{processor:.3f}", f"{throughput:.3f}", ""]]))
    return {"rounds": rounds, "processor_ratio": processor, "throughput_ratio": throughput}


def line(found, name):
    print(
        f"{name:>9}  {found['rate']:.0f}/s asked  {found['captured_per_second']:.0f}/s  lost {found['lost']}  "
        f"law broken {found['law_broken']} of {found['law_checked']}  "
        f"verified p50 {found['p50_ms']:.0f} p99 {found['p99_ms']:.0f} ms  "
        f"{found['cores']:.2f} cores  {found['processor_us']:.1f} us a message  {found['throughput']:.0f} verified/s",
        flush=True,
    )


def rate(arguments, folder):
    cores = sorted(os.sched_getaffinity(0))[: arguments.cores]
    os.sched_setaffinity(0, cores)
    program, begun, runs = Program(arguments.bench, folder), time.monotonic(), []

    def run(asked, length):
        document = program.pipeline(asked, arguments.publishers, length, arguments.before)
        found = figures(document) if document else {"rate": asked, "held": False}
        runs.append({**found, "seconds": length})
        if document:
            line(found, "held" if found["held"] else "not held")
        return found["held"]

    def has_time(length):
        return time.monotonic() - begun + spent + length < arguments.minutes * 60

    before = time.monotonic()
    is_held = run(arguments.rate, arguments.length)
    # What a step takes besides its load: records put there before, and what is waited for.
    spent = time.monotonic() - before - arguments.length
    asked, step = arguments.first, arguments.step_length
    if has_time(step):
        was_held = run(asked, step)
        while has_time(step) and asked >= 2 * LOWEST:
            asked = asked * 2 if was_held else asked // 2
            if run(asked, step) != was_held:
                break
    highest = max((one["rate"] for one in runs if one["held"]), default=0)
    head = ["asked/s", "for s", "captured/s", "verified", "lost", "law broken", "p50 ms", "p99 ms", "fsync ms", "cores", ""]
    print(table(head, [row(one) for one in runs]))
    print(f"{len(cores)} cores, {arguments.before} records there before; highest rate held: {highest:.0f}/s")
    return {"runs": runs, "held": is_held, "highest": highest, "cores": cores}


def row(found):
    if "p99_ms" not in found:
        return [f"{found['rate']:.0f}", found["seconds"], *["-"] * 8, "not verified in time"]
    return [
        f"{found['rate']:.0f}",
        found["seconds"],
        f"{found['captured_per_second']:.0f}",
        found["verified"],
        found["lost"],
        f"{found['law_broken']} of {found['law_checked']}",
        f"{found['p50_ms']:.0f}",
        f"{found['p99_ms']:.0f}",
        f"{found['fsync_p50_ms']:.2f} (p95 {found['fsync_p95_ms']:.2f})",
        f"{found['cores']:.2f}",
        "held" if found["held"] else "not held",
    ]


def parsed():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ways = parser.add_subparsers(dest="way", required=True)
    compared, held = ways.add_parser("compare"), ways.add_parser("rate")
    compared.add_argument("bench")
    compared.add_argument("reference")
    compared.add_argument("--rounds", type=int, default=5)
    compared.add_argument("--rate", type=int, default=2_000, help="messages a second that both hold")
    compared.add_argument("--for", dest="length", type=seconds, default="20s")
    compared.add_argument("--flood", type=int, default=12_000, help="messages a second that none holds")
    compared.add_argument("--flood-for", dest="flood_length", type=seconds, default="8s")
    held.add_argument("bench")
    held.add_argument("--rate", type=int, default=8_000)
    held.add_argument("--for", dest="length", type=seconds, default="5m")
    held.add_argument("--before", type=int, default=1_000_000)
    held.add_argument("--first", type=int, default=10_000, help="first step after it, doubled or halved")
    held.add_argument("--step-for", dest="step_length", type=seconds, default="60s")
    held.add_argument("--cores", type=int, default=2)
    for one in (compared, held):
        one.add_argument("--publishers", type=int, default=50)
        one.add_argument("--minutes", type=float, default=20, help="no run begins that would end later")
    return parser.parse_args()


def main():
    arguments = parsed()
    # Interrupted or told to end, it ends the bench that runs.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))
    print(f"load of the machine before: {os.getloadavg()[0]:.2f}", flush=True)
    with tempfile.TemporaryDirectory(prefix="authros-figures-", ignore_cleanup_errors=True) as folder:
        found = {"compare": compare, "rate": rate}[arguments.way](arguments, folder)
    print(json.dumps({"way": arguments.way, **found}))


if __name__ == "__main__":
    main()
