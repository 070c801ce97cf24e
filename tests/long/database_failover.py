#!/usr/bin/python3
"""A gateway's database fails over under load: three PostgreSQL servers under Patroni and etcd, each in a network namespace of its own
with a disk of its own, two of them standbys of which one must have each commit. Robots bring records all the time.

usage: database_failover.py PROGRAM [--times N] [--robots N] [--seed N] [--only SCENE ...]

PROGRAM is an `authros`. Needs root, PostgreSQL, patroni, etcd, iproute2. Scenes, in this order:

    cut        the primary's line is cut: it acknowledges nothing, a standby is promoted, the old primary follows
    full       the primary's disk is full, until there is room again
    standby    one standby is gone: records are acknowledged all the same
    standbys   both are gone: nothing is acknowledged, also not what a gateway that was killed is sent again; then the primary
               dies, a standby is promoted, and what nobody acknowledged is brought again
    return     the first server is the primary again, on purpose
    kills      the primary dies N times, in turn its machine and its postmaster alone; the old primary comes back as a standby

What robots noted as acknowledged is compared with the database after each, and at the end with what the owner's and a reader's lists
have. The last line is JSON. Everything runs in namespaces that end with it.
"""
import argparse
import contextlib
import json
import os
import pathlib
import random
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

HUB, SERVERS = "authros-fo", {f"n{number}": f"10.77.0.{number}" for number in (1, 2, 3)}
HUB_ADDRESS, PASSWORD, TOPIC = "10.77.0.254", "hunter2-of-the-store", "/robot1/camera/compressed"
SUBMITTED, VERIFIED = 3, 6
# Records of messages, which a list has; not those about losses.
DATA = "stream IN (SELECT key FROM streams WHERE kind = 1)"
DISK = 1 << 30
# The exit code of what is tried again.
UNREACHABLE = 4
# Seconds: how soon the gateway must acknowledge after a promotion, and how long anything else may take.
SOON, PATIENCE = 15, 300


def run(*words, check=True, **more):
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False, **more)
    if check and done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout.strip()


def until(what, found, patience=PATIENCE, pause=0.1):
    """The first answer that is true."""
    end = time.monotonic() + patience
    while True:
        answer = found()
        if answer:
            return answer
        if time.monotonic() > end:
            raise SystemExit(f"not within {patience} s: {what}")
        time.sleep(pause)


def need(holds, what):
    if not holds:
        raise SystemExit(f"it does not hold: {what}")


def say(text):
    print(f"{time.strftime('%H:%M:%S')} {text}", flush=True)


class Processes:
    """All that was started, in its namespaces; ends with this program."""

    def __init__(self, folder):
        self.folder, self.all = folder, []

    def start(self, name, *words, namespace=None, user=None, environment=None):
        words = [str(word) for word in words]
        if user:
            words = ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", *words]
        if namespace:
            words = ["ip", "netns", "exec", namespace, *words]
        log = (self.folder / f"{name}.log").open("ab")
        process = subprocess.Popen(words, stdout=log, stderr=subprocess.STDOUT, env=environment, start_new_session=True, cwd="/")
        log.close()
        self.all.append(process)
        return process

    def end(self):
        for process in self.all:
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()


class Network:
    """A bridge in the hub, where everything but the servers is, and a line to each server."""

    def __enter__(self):
        self.__exit__()
        run("ip", "netns", "add", HUB)
        run("ip", "-n", HUB, "link", "set", "lo", "up")
        run("ip", "-n", HUB, "link", "add", "br0", "type", "bridge")
        run("ip", "-n", HUB, "address", "add", f"{HUB_ADDRESS}/24", "dev", "br0")
        run("ip", "-n", HUB, "link", "set", "br0", "up")
        for name, address in SERVERS.items():
            space = self.space(name)
            run("ip", "netns", "add", space)
            run("ip", "-n", HUB, "link", "add", name, "type", "veth", "peer", "name", "eth0", "netns", space)
            run("ip", "-n", HUB, "link", "set", name, "master", "br0", "up")
            run("ip", "-n", space, "address", "add", f"{address}/24", "dev", "eth0")
            for link in ("lo", "eth0"):
                run("ip", "-n", space, "link", "set", link, "up")
        return self

    def __exit__(self, *_):
        for space in (HUB, *map(self.space, SERVERS)):
            for process in run("ip", "netns", "pids", space, check=False).split():
                if int(process) != os.getpid():
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(int(process), signal.SIGKILL)
            run("ip", "netns", "delete", space, check=False)

    @staticmethod
    def space(name):
        return f"{HUB}-{name}"


class Server:
    """One of the three, with Patroni. It runs as the user postgres."""

    def __init__(self, name, folder, programs, processes):
        self.name, self.address, self.programs, self.processes = name, SERVERS[name], programs, processes
        self.space, self.disk = Network.space(name), folder / name
        self.disk.mkdir()
        run("mount", "-t", "tmpfs", "-o", f"size={DISK},mode=0700", "tmpfs", self.disk)
        self.settings = self.disk / "patroni.json"
        self.settings.write_text(json.dumps(self.patroni()))
        run("chown", "-R", "postgres:postgres", self.disk)

    def patroni(self):
        login = lambda user: {"username": user, "password": PASSWORD}
        parameters = {
            "max_connections": 60, "shared_buffers": "32MB", "min_wal_size": "32MB", "max_wal_size": "64MB",
            "wal_keep_size": "256MB", "wal_log_hints": "on", "log_line_prefix": "%m [%p] ", "wal_sender_timeout": "5s",
        }
        dcs = {
            "ttl": 20, "loop_wait": 2, "retry_timeout": 8, "primary_start_timeout": 0, "maximum_lag_on_failover": 1 << 20,
            "postgresql": {"use_pg_rewind": True, "use_slots": False, "parameters": parameters},
        }
        own = f"{self.address}:5432"
        return {
            "scope": "fleet", "name": self.name, "etcd3": {"host": f"{HUB_ADDRESS}:2379"},
            "restapi": {"listen": f"{self.address}:8008", "connect_address": f"{self.address}:8008"},
            "bootstrap": {"dcs": dcs, "initdb": [{"encoding": "UTF8"}, {"locale": "C"}, "data-checksums"]},
            "postgresql": {
                "listen": own, "connect_address": own, "data_dir": str(self.disk / "data"), "bin_dir": str(self.programs),
                "pgpass": str(self.disk / "pgpass"), "parameters": {"unix_socket_directories": str(self.disk)},
                "pg_hba": ["local all all trust", "host all all 10.77.0.0/24 trust", "host replication all 10.77.0.0/24 trust"],
                "authentication": {"superuser": login("postgres"), "replication": login("follower"), "rewind": login("rewinder")},
            },
        }

    def start(self):
        self.processes.start(self.name, "patroni", self.settings, namespace=self.space, user="postgres", environment={"PATH": os.environ["PATH"], "LANG": "C.UTF-8"})

    def kill_machine(self):
        for process in run("ip", "netns", "pids", self.space).split():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(process), signal.SIGKILL)
        until("nothing of it runs", lambda: not run("ip", "netns", "pids", self.space))

    def kill_postmaster(self):
        os.kill(int((self.disk / "data/postmaster.pid").read_text().split()[0]), signal.SIGKILL)

    def cut(self, is_cut):
        run("ip", "-n", HUB, "link", "set", self.name, "down" if is_cut else "up")

    def is_role(self, role):
        try:
            with urllib.request.urlopen(f"http://{self.address}:8008/{role}", timeout=1) as answer:
                return answer.status == 200
        except OSError:
            return False

    def ask(self, method, path, body):
        """Patroni."""
        request = urllib.request.Request(f"http://{self.address}:8008/{path}", json.dumps(body).encode(), {"Content-Type": "application/json"}, method=method)
        urllib.request.urlopen(request, timeout=60).close()

    def sql(self, statement, database="fleet", check=True, space=HUB):
        """Asked over the network, or inside its own namespace."""
        inside = [] if space == HUB else ["ip", "netns", "exec", space]
        host = self.address if space == HUB else self.disk
        return run(
            *inside, self.programs / "psql", "-XAtq", "-v", "ON_ERROR_STOP=1", "-h", host, "-U", "postgres", "-c", statement, database, check=check,
            env={"PGCONNECT_TIMEOUT": "3", "PATH": os.environ["PATH"]},
        )


class Cluster:
    def __init__(self, folder, programs, processes):
        self.processes = processes
        self.servers = [Server(name, folder, programs, processes) for name in SERVERS]
        etcd = f"http://{HUB_ADDRESS}"
        processes.start(
            "etcd", "etcd", "--data-dir", folder / "etcd", "--listen-client-urls", f"{etcd}:2379", "--advertise-client-urls", f"{etcd}:2379",
            "--listen-peer-urls", f"{etcd}:2380", "--initial-advertise-peer-urls", f"{etcd}:2380", "--initial-cluster", f"default={etcd}:2380",
            namespace=HUB, environment={"PATH": os.environ["PATH"]},
        )
        self.servers[0].start()
        self.first = until("the first server is the primary", self.primary)
        for server in self.servers[1:]:
            server.start()
        self.whole("async")
        self.first.sql(f"CREATE ROLE authros LOGIN PASSWORD '{PASSWORD}'", "postgres")
        self.first.sql("CREATE DATABASE fleet OWNER authros", "postgres")
        self.first.sql("GRANT pg_monitor TO authros", "postgres")
        # Not before: commits would wait for standbys that are not there yet. Not in Patroni's settings: outside of its own
        # synchronous mode it empties them at each promotion.
        for server in self.servers:
            until(f"{server.name} answers", lambda server=server: server.sql("SELECT 1", "postgres", check=False) == "1")
            server.sql(f"ALTER SYSTEM SET synchronous_standby_names = 'ANY 1 ({', '.join(SERVERS)})'", "postgres")
            server.sql("SELECT pg_reload_conf()", "postgres")
        self.whole()

    @property
    def url(self):
        return f"postgres://authros:{PASSWORD}@{','.join(SERVERS.values())}/fleet?sslmode=disable&target_session_attrs=read-write"

    def primary(self):
        return next((server for server in self.servers if server.is_role("primary")), None)

    def whole(self, state="quorum"):
        """Both standbys follow the primary."""
        def follows():
            primary = self.primary()
            count = primary and primary.sql(f"SELECT count(*) FROM pg_stat_replication WHERE state = 'streaming' AND sync_state = '{state}'", "postgres", check=False)
            return count == "2" and primary

        return until("two standbys follow the primary", follows, pause=0.3)

    def promoted(self, old):
        return until("another server is the primary", lambda: next((one for one in self.servers if one is not old and one.is_role("primary")), None), pause=0.05)


class Home:
    """A user with a home, in the hub."""

    def __init__(self, name, folder, program, processes, environment=None):
        self.name, self.root, self.program, self.processes = name, folder / name, program, processes
        self.root.mkdir()
        fixed = {"HOME": str(self.root), "PATH": os.environ["PATH"], "LANG": "C.UTF-8", "AUTHROS_STORE_PASSPHRASE": "yes", "AUTHROS_AUDIT_ANCHOR_EVERY": "86400"}
        self.environment, self.options = {**fixed, **(environment or {})}, ["--json", "--home", str(self.root / "site"), "--profile", name]

    def start(self, *words, log=None):
        return self.processes.start(log or self.name, self.program, *words, *self.options, environment=self.environment)

    def log(self, name=None):
        path = self.processes.folder / f"{name or self.name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def json(self, *words, codes=(0,)):
        def ended():
            done = subprocess.run([self.program, *words, *self.options], capture_output=True, text=True, env=self.environment, timeout=PATIENCE, check=False)
            return done if done.returncode in codes or done.returncode != UNREACHABLE else None

        done = until(f"{self.name}: {' '.join(words)}", ended, pause=2)
        need(done.returncode in codes, f"{self.name}: {' '.join(words)} ends with {done.returncode}: {done.stderr or done.stdout}")
        return json.loads(done.stdout.strip().splitlines()[-1]) if done.stdout.strip() else None

    def listed(self, *words):
        """Digests and states of all records of a list; None while it is incomplete."""
        found, after = [], None
        while True:
            page = self.json(*words, "--limit", "1000", *(["--after", after] if after else []), codes=(0, 4, 8))
            if page is None or "records" not in page:
                return None
            found.extend((row["digest"], row["state"]) for row in page["records"])
            after = page.get("next")
            if not after:
                return found


class Robots:
    """Robots that capture and send, and all that they ever noted as acknowledged."""

    def __init__(self, scene, count):
        self.homes, self.noted, self.lock, self.over = [], set(), threading.Lock(), threading.Event()
        for number in range(count):
            home = Home(f"robot{number}", scene.folder, scene.program, scene.processes)
            paper = home.root / "robot.enrolment"
            scene.alice.json("robot", "enrol", "--name", f"scout{number}", "--topic", TOPIC, "--out", str(paper), "--gateway", scene.address, "--gateway-key", scene.key)
            home.options = ["--json", "--home", str(home.root / "site")]
            home.process = home.start("robot", "run", str(paper), "--robots", "1")
            self.homes.append(home)
        self.thread = threading.Thread(target=self.watch, daemon=True)
        self.thread.start()

    def rows(self, condition):
        found = set()
        for home in self.homes:
            ledger = home.root / "site/ledger.db"
            if ledger.exists():
                with contextlib.suppress(sqlite3.OperationalError), contextlib.closing(sqlite3.connect(f"file:{ledger}?mode=ro", uri=True, timeout=5)) as base:
                    found.update(bytes(row[0]).hex() for row in base.execute(f"SELECT digest FROM records WHERE {condition}"))
        return found

    def watch(self):
        while not self.over.wait(0.2):
            self.note()

    def note(self):
        acknowledged = self.rows(f"state BETWEEN {SUBMITTED} AND {VERIFIED}")
        with self.lock:
            self.noted |= acknowledged
            return set(self.noted)

    def grow(self, than, patience=PATIENCE):
        """Waits until more is acknowledged than this."""
        return until("records are acknowledged", lambda: (now := self.note()) - than and now, patience, 0.1)

    def end(self):
        for home in self.homes:
            os.kill(home.process.pid, signal.SIGTERM)
        for home in self.homes:
            home.process.wait(PATIENCE)
        self.over.set()
        self.thread.join()


class Scene:
    def __init__(self, folder, program, processes, cluster):
        self.folder, self.program, self.processes, self.cluster = folder, program, processes, cluster
        self.figures = []
        self.founder = Home("founder", folder, program, processes)
        self.founder.options += ["--robots", "0"]
        self.founder.start("chain", "serve", "--listen", "127.0.0.1:0")
        line = until("a chain is served", lambda: next((line for line in self.founder.log().splitlines() if '"serving"' in line), None))
        url = json.loads(line)["serving"]["url"]
        contract = self.founder.json("chain", "deploy")["contract"]
        self.keeper = Home("keeper", folder, program, processes, {"AUTHROS_STORE": cluster.url})
        self.keeper.options += ["--robots", "0", "--chain", url, "--contract", contract, "--confirmations", "1"]
        self.address = "127.0.0.1:7420"
        self.serve()
        member = {"AUTHROS_SITE": self.address, "AUTHROS_GATEWAY_KEY": self.key}
        self.alice, self.bob = (Home(name, folder, program, processes, member) for name in ("alice", "bob"))
        accounts = {}
        for home in (self.alice, self.bob):
            accounts[home.name] = home.json("identity", "register")["address"]
            self.keeper.json("gateway", "allow", accounts[home.name])
            home.start("serve")
            until(f"{home.name} serves", lambda home=home: "serving" in home.log())
        self.owner, print_of = accounts["alice"], self.bob.json("identity", "show")["fingerprint"]
        self.alice.json("contacts", "add", "bob", accounts["bob"], "--fingerprint", print_of)
        self.alice.json("grant", "add", "--to", "bob")

    def serve(self):
        """Until it serves; one that ends starts again after five seconds, as systemd does it."""
        log = ""

        def serves():
            nonlocal log
            if not log or self.gateway.poll() is not None:
                time.sleep(5 if log else 0)
                log = f"keeper{len(self.processes.all)}"
                self.gateway = self.keeper.start("gateway", "serve", "--listen", self.address, log=log)
            return next((line for line in self.keeper.log(log).splitlines() if '"gateway":' in line), None)

        self.key = json.loads(until("the gateway serves", serves))["gateway"]["gateway"]

    def compare(self):
        """Each record that a robot noted as acknowledged is in the database once."""
        noted = self.robots.note()
        primary = self.cluster.primary()
        rows = primary.sql("SELECT encode(digest, 'hex') FROM records JOIN ciphertext ON record = n").split()
        lost, doubled = noted - set(rows), len(rows) - len(set(rows))
        doubled += int(primary.sql("SELECT count(*) - count(DISTINCT (topic, seq)) FROM records"))
        doubled += int(primary.sql("SELECT count(*) - count(DISTINCT record) FROM feed"))
        need(not lost and not doubled, f"{len(lost)} acknowledged records lost, {doubled} doubled: {sorted(lost)[:3]}")
        return len(noted)

    def fails_over(self, what, fail):
        """Seconds from the failure to the promotion, and from there to the gateway's first commit and a robot's first receipt."""
        old, begun = self.cluster.whole(), self.robots.note()
        self.robots.grow(begun)
        failed = time.monotonic()
        fail(old)
        new = self.cluster.promoted(old)
        promoted, noted = time.monotonic(), self.robots.note()
        committed = "SELECT count(*) FROM pg_stat_activity WHERE usename = 'authros' AND query = 'COMMIT' AND state = 'idle'"
        until("the gateway has committed something", lambda: new.sql(committed, "postgres", check=False) not in ("", "0"))
        writable = time.monotonic() - promoted
        self.robots.grow(noted)
        received = time.monotonic() - promoted
        self.figures.append({"what": what, "promoted": promoted - failed, "writable": writable, "received": received})
        say(f"{what}: {old.name} -> {new.name}, promoted after {promoted - failed:.1f} s, commits {writable:.1f} s later, a robot has a receipt after {received:.1f} s")
        return old, new

    def kills(self, times):
        for number in range(times):
            if number % 2:
                old, _ = self.fails_over("postmaster killed", Server.kill_postmaster)
            else:
                old, _ = self.fails_over("machine killed", Server.kill_machine)
                old.start()
            self.cluster.whole()
            say(f"  {old.name} follows again; {self.compare()} acknowledged, none lost, none doubled ({number + 1} of {times})")

    def cut(self):
        old, _ = self.fails_over("line cut", lambda old: old.cut(True))
        there = old.sql("SELECT pg_is_in_recovery()", "postgres", check=False, space=old.space)
        say(f"  behind the cut it {'is a standby' if there == 't' else 'is down' if not there else 'is a primary that acknowledges nothing'}")
        self.compare()
        old.cut(False)
        self.cluster.whole()
        say(f"  {old.name} follows again; {self.compare()} acknowledged, none lost, none doubled")

    def full(self):
        filling = lambda server: server.disk / "filling"

        def fill(server):
            run("dd", "if=/dev/zero", f"of={filling(server)}", "bs=1M", check=False)

        old, noted = self.cluster.whole(), self.robots.note()
        self.robots.grow(noted)
        fill(old)
        begun, seen = time.monotonic(), self.robots.note()
        # What the server does is its own matter: it may refuse statements, or end for want of room for its log.
        while time.monotonic() < begun + 30 and self.cluster.primary() is old:
            time.sleep(0.5)
        new = self.cluster.primary()
        grew = len(self.robots.note() - seen)
        say(f"disk full: after {time.monotonic() - begun:.0f} s the primary is {new.name if new else 'nobody'}, {grew} acknowledged meanwhile")
        filling(old).unlink()
        until("there is a primary", self.cluster.primary)
        roomy, noted = time.monotonic(), self.robots.note()
        self.robots.grow(noted)
        say(f"  room again: acknowledges after {time.monotonic() - roomy:.1f} s")
        self.cluster.whole()
        say(f"  {self.compare()} acknowledged, none lost, none doubled")

    def standby(self):
        primary = self.cluster.whole()
        gone = next(server for server in self.cluster.servers if server is not primary)
        gone.kill_machine()
        for _ in range(3):
            self.robots.grow(self.robots.note(), SOON)
        say(f"standby {gone.name} gone: records are acknowledged all the same")
        gone.start()
        self.cluster.whole()
        self.compare()

    def standbys(self):
        primary = self.cluster.whole()
        gone = [server for server in self.cluster.servers if server is not primary]
        self.robots.grow(self.robots.note())
        for server in gone:
            server.cut(True)
        until("no standby is connected", lambda: primary.sql("SELECT count(*) FROM pg_stat_replication", "postgres") == "0", 30)
        time.sleep(1)
        before = self.robots.note()
        time.sleep(5)
        need(self.robots.note() == before, "nothing is acknowledged without a standby")
        # A new gateway is sent the same again while the first one's commits wait, and after somebody ended that wait: what is visible
        # on the primary then is on no standby.
        self.gateway.kill()
        self.gateway.wait()
        started = threading.Thread(target=self.serve, daemon=True)
        started.start()
        time.sleep(10)
        primary.sql("SELECT pg_cancel_backend(pid) FROM pg_stat_activity WHERE wait_event = 'SyncRep'", "postgres")
        time.sleep(10)
        alone = set(primary.sql("SELECT encode(digest, 'hex') FROM records").split()) - before
        acknowledged = self.robots.note() - before
        need(not acknowledged, f"a repeated upload is not acknowledged without a standby, but {len(acknowledged)} were")
        seen = [server.name for server in gone]
        say(f"standbys {' and '.join(seen)} gone: 0 acknowledged in 26 s; {len(alone)} records are on the primary alone, sent again to a new gateway")
        need(alone, "some records are on the primary alone")
        primary.kill_machine()
        for server in gone:
            server.cut(False)
        new = self.cluster.promoted(primary)
        kept = set(new.sql("SELECT encode(digest, 'hex') FROM records").split())
        lost = alone - kept
        promoted, noted = time.monotonic(), self.robots.note()
        need(not lost & noted, "what died with the primary was not acknowledged")
        started.join(PATIENCE)
        self.robots.grow(noted)
        self.figures.append({"what": "both standbys gone, then the primary", "received": time.monotonic() - promoted})
        say(f"  {new.name} promoted without {len(lost)} of them, acknowledges {time.monotonic() - promoted:.1f} s later")
        primary.start()
        self.cluster.whole()
        until("what died with the primary was brought again", lambda: lost <= set(new.sql("SELECT encode(digest, 'hex') FROM records").split()))
        say(f"  all of them are brought again; {self.compare()} acknowledged, none lost, none doubled")

    def back(self):
        first = self.cluster.servers[0]
        primary = self.cluster.whole()
        if primary is first:
            return

        def switch(old):
            old.ask("POST", "switchover", {"leader": old.name, "candidate": first.name})

        _, new = self.fails_over("switched back", switch)
        need(new is first, f"{first.name} is the primary")
        self.cluster.whole()
        self.compare()

    def finish(self):
        """Everything that robots captured is in the owner's and the reader's list, once and verified."""
        self.robots.end()
        all_of = self.robots.rows(DATA)
        for home in self.robots.homes:
            paper = home.root / "robot.enrolment"
            home.process = home.start("robot", "run", str(paper), "--robots", "1", "--count", "1")
        for home in self.robots.homes:
            need(home.process.wait(PATIENCE * 2) == 0, f"{home.name} brings the rest")
        all_of |= self.robots.rows(DATA)
        acknowledged = self.compare()
        for home, words in ((self.alice, ("records", "list", "--oldest")), (self.bob, ("received", "list", "--oldest", "--owner", self.owner))):
            def listed(home=home, words=words):
                found = home.listed(*words)
                done = found is not None and len(found) >= len(all_of) and all(state == "verified" for _, state in found)
                return found if done else None

            found = until(f"{home.name}'s list is whole", listed, PATIENCE * 2, 2)
            digests = {digest for digest, _ in found}
            need(len(found) == len(digests) and digests == all_of, f"{home.name} has each record once: {len(found)} rows, {len(all_of)} records")
        opened = self.bob.json("records", "open", min(all_of))
        need(opened["verdict"] == "verified", "the reader opens a record")
        return acknowledged, len(all_of)


def scenes(arguments, folder, processes):
    programs = next(path for path in sorted(pathlib.Path("/usr/lib/postgresql").glob("*/bin"), reverse=True) if (path / "postgres").exists())
    cluster = Cluster(folder, programs, processes)
    say(f"{cluster.first.name} is the primary, two standbys follow")
    scene = Scene(folder, os.path.abspath(arguments.program), processes, cluster)
    scene.robots = Robots(scene, arguments.robots)
    scene.robots.grow(set())
    say(f"{arguments.robots} robots bring records")
    acts = {"cut": scene.cut, "full": scene.full, "standby": scene.standby, "standbys": scene.standbys, "return": scene.back, "kills": lambda: scene.kills(arguments.times)}
    for name, act in acts.items():
        if not arguments.only or name in arguments.only:
            act()
    acknowledged, records = scene.finish()
    writable, received = ([figure[name] for figure in scene.figures if name in figure] for name in ("writable", "received"))
    print(json.dumps({
        "fail_overs": len(writable), "writable_p50": round(statistics.median(writable), 2) if writable else None,
        "writable_max": round(max(writable), 2) if writable else None,
        "received_p50": round(statistics.median(received), 2) if received else None, "received_max": round(max(received), 2) if received else None,
        "promoted_p50": round(statistics.median([one["promoted"] for one in scene.figures if "promoted" in one] or [0]), 2),
        "acknowledged": acknowledged, "records": records, "lost": 0, "doubled": 0, "each": scene.figures,
    }))
    need(not writable or max(writable) <= SOON, f"writable {SOON} s after each promotion")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--robots", type=int, default=3)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--keep", help="folder for logs")
    parser.add_argument("--inside", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if not arguments.inside:
        folder = arguments.keep or tempfile.mkdtemp(prefix="failover")
        os.makedirs(folder, exist_ok=True)
        os.chmod(folder, 0o711)
        with Network():
            return subprocess.run(["ip", "netns", "exec", HUB, sys.executable, *sys.argv, "--inside", folder], check=False).returncode
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    folder = pathlib.Path(arguments.inside)
    processes = Processes(folder)
    try:
        scenes(arguments, folder, processes)
    finally:
        processes.end()
    return 0


if __name__ == "__main__":
    sys.exit(main())
