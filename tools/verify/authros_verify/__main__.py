"""authros-verify NAME.authros [--trust trust.toml] [--recording FILE] [--json]

Ends with 0 where the bundle holds, 8 where something is not proven, 6 where something is refused, 9 where nothing is refused but
something could not be checked here, 3 where a file or the trust file cannot be used, and 2 where the command is another one.
"""
import argparse
import json
import sys

from . import TrustError, verify


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="authros-verify", description="Verifies an evidence bundle of AuthROS, offline.")
    parser.add_argument("bundle", metavar="NAME.authros")
    parser.add_argument("--trust", metavar="trust.toml", help="what you know from another source than the bundle")
    parser.add_argument("--recording", metavar="FILE", help="a recorded file to compare with what the bundle states of it")
    parser.add_argument("--json", action="store_true", help="all details")
    given = parser.parse_args(arguments)
    try:
        found = verify(given.bundle, given.trust, given.recording)
    except (TrustError, OSError) as why:
        print(f"authros-verify: {why}", file=sys.stderr)
        return 3
    if given.json:
        print(json.dumps(found.document(), indent=1))
    else:
        print("\n".join(found.lines()))
        compared = found.recording
        if compared:
            print(f"Recording: {compared['standing']}, {compared['bytes']:,} bytes, {len(compared['differing'])} of {compared['chunks']} chunks differ.")
    return found.exit_code


if __name__ == "__main__":
    sys.exit(main())
