#!/usr/bin/env python3
"""Lists what a released file holds and what built it, as CycloneDX 1.5, from the lock files alone.

    packaging/cyclonedx.py verify.html|authros-verify VERSION FILE

The list of a program is written by packaging/notices, which knows what cargo puts into it. SOURCE_DATE_EPOCH is its time.
"""

import base64
import json
import os
import re
import sys
from datetime import datetime, timezone
from pathlib import Path
from urllib.parse import quote

ROOT = Path(__file__).resolve().parent.parent
PAGE_LOCK = "tools/verify-page/package-lock.json"
CHECKSUMS = {"sha256": "SHA-256", "sha512": "SHA-512"}


def component(kind, registry, name, version, licence=None, hashes=()):
    address = f"pkg:{registry}/{quote(name)}@{version}"
    listed = {"type": kind, "bom-ref": address, "name": name, "version": version, "purl": address}
    if hashes:
        listed["hashes"] = [{"alg": CHECKSUMS[way], "content": digest} for way, digest in hashes]
    if licence:
        listed["licenses"] = [{"expression": licence.replace("/", " OR ")}]
    return listed


def crates():
    """What Cargo.lock says of each package: by name and version, its checksum and the packages that it uses."""
    locked, uses = {}, {}
    for block in (ROOT / "Cargo.lock").read_text().split("[[package]]")[1:]:
        fields = dict(re.findall(r'^(\w+) = "(.*)"$', block, re.MULTILINE))
        one = fields["name"], fields["version"]
        locked[one] = fields.get("checksum")
        listed = re.search(r"^dependencies = \[(.*?)\]", block, re.MULTILINE | re.DOTALL)
        uses[one] = re.findall(r'"(\S+)(?: (\S+))?.*"', listed.group(1)) if listed else []
    # A version is named only where the lock file has several of that name.
    found = lambda name, version: next(one for one in locked if one[0] == name and version in ("", one[1]))
    return locked, {one: [found(*other) for other in named] for one, named in uses.items()}


def page():
    """npm's packages for verify.html: those in it, those that build it, and which uses which."""
    packages = json.loads((ROOT / PAGE_LOCK).read_text())["packages"]
    held, builders, places = [], [], {"verify.html": ""}
    for place, package in packages.items():
        name = place.rpartition("node_modules/")[2]
        # esbuild has a package for each kind of machine beside the one that names them all.
        if not place or name.startswith("@esbuild/"):
            continue
        way, digest = package["integrity"].split("-", 1)
        hashes = [(way, base64.b64decode(digest).hex())]
        details = "npm", name, package["version"], package.get("license"), hashes
        if package.get("dev"):
            builders.append(component("application", *details))
        else:
            held.append(component("library", *details))
            places[held[-1]["bom-ref"]] = place
    addresses = {place: address for address, place in places.items()}

    def used(place, name):
        # A second version of a package is inside of the one that uses it.
        inside = f"{place}/node_modules/{name}"
        return addresses[inside if inside in addresses else f"node_modules/{name}"]

    uses = {one: [used(at, name) for name in packages[at].get("dependencies", {})] for one, at in places.items()}
    return held, builders, uses


def toolchain():
    """What compiles and links a program: the Rust toolchain, and packages of PyPI by version and hash."""
    channel = re.search(r'^channel = "(.+)"$', (ROOT / "rust-toolchain.toml").read_text(), re.MULTILINE).group(1)
    tools = [component("application", "generic", "rust", channel)]
    for entry in re.split(r"(?<!\\)\n", (ROOT / "packaging/requirements.txt").read_text()):
        pinned = re.match(r"([\w.-]+)==(\S+)", entry)
        if pinned:
            hashes = re.findall(r"--hash=(\w+):([0-9a-f]+)", entry)
            tools.append(component("application", "pypi", *pinned.groups(), hashes=hashes))
    return tools


def write(file, own, version, components, tools, uses):
    """`uses` has what each uses, and what the released file itself uses under its name."""
    when = datetime.fromtimestamp(int(os.environ["SOURCE_DATE_EPOCH"]), timezone.utc)
    metadata = {
        "timestamp": when.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "tools": {"components": tools},
        "authors": [{"name": "The AuthROS authors"}],
        "component": {
            "type": "application", "bom-ref": own, "name": own, "version": version,
            "licenses": [{"expression": "Apache-2.0"}],
        },
    }
    dependencies = [{"ref": ref, "dependsOn": sorted(uses[ref])} for ref in sorted(uses)]
    bill = {
        "$schema": "http://cyclonedx.org/schema/bom-1.5.schema.json",
        "bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1,
        "metadata": metadata, "components": components, "dependencies": dependencies,
    }
    Path(file).write_text(json.dumps(bill, indent=1) + "\n")


def main():
    if len(sys.argv) != 4 or sys.argv[1] not in ("verify.html", "authros-verify"):
        sys.exit(__doc__)
    own, version, file = sys.argv[1:]
    # The package in Python uses Python's own library alone, and so does what builds it.
    components, tools, uses = page() if own == "verify.html" else ([], [], {own: []})
    write(file, own, version, components, tools, uses)


if __name__ == "__main__":
    main()
