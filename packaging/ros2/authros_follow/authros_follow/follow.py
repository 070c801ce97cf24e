"""Finds the program authros and becomes `authros bag follow`.

    ros2 run authros_follow follow DIR [--until-closed] [--tag KEY=VALUE] [--topic PATTERN]

The program is taken from AUTHROS_PROGRAM, else from PATH, else from where packages and cargo put it. Everything that ROS adds
behind --ros-args is left out.
"""

import os
import shutil
import sys

PLACES = ("/usr/bin/authros", "/usr/local/bin/authros", os.path.expanduser("~/.cargo/bin/authros"))
NOT_FOUND = (
    "authros_follow: the program authros was not found. Install its package, or name it in AUTHROS_PROGRAM; "
    "docs/gateway.md of AuthROS has the ways."
)


def program(environment):
    """The path of authros; None if it is nowhere."""
    named = environment.get("AUTHROS_PROGRAM")
    if named:
        return shutil.which(named)
    return shutil.which("authros") or next((place for place in PLACES if os.access(place, os.X_OK)), None)


def command(path, arguments):
    """The command line: the options of every command, such as --home, come first."""
    if "--ros-args" in arguments:
        arguments = arguments[:arguments.index("--ros-args")]
    return [path, "bag", "follow", *arguments]


def main(arguments=None):
    path = program(os.environ)
    if path is None:
        print(NOT_FOUND, file=sys.stderr)
        return 3
    line = command(path, sys.argv[1:] if arguments is None else arguments)
    # Its signals and its exit code are those of the program.
    os.execv(path, line)


if __name__ == "__main__":
    sys.exit(main())
