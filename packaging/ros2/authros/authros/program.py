"""Finds the program authros and becomes one of its commands.

    ros2 run authros authros COMMAND ...     any command; without one, the console
    ros2 run authros follow DIR ...          authros bag follow: seals what is recorded into DIR
    ros2 run authros agent ENROLMENT ...     authros robot run: captures for the robot's gateway
    ros2 run authros serve ...               authros serve: a site without a console

AUTHROS_PROGRAM names the program, else PATH is searched, then the places of packages and cargo. What ROS adds from --ros-args on
is left out.
"""

import os
import shutil
import sys

PLACES = ("/usr/bin/authros", "/usr/local/bin/authros", os.path.expanduser("~/.cargo/bin/authros"))
NOT_FOUND = (
    "install the package authros, or name the program in AUTHROS_PROGRAM: it was not found in PATH, /usr/bin, /usr/local/bin or "
    "~/.cargo/bin"
)


def found(environment):
    """The path of authros; None if it is nowhere."""
    named = environment.get("AUTHROS_PROGRAM")
    if named:
        return shutil.which(named)
    return shutil.which("authros") or next((place for place in PLACES if os.access(place, os.X_OK)), None)


def become(*command):
    path = found(os.environ)
    if path is None:
        print(f"authros: {NOT_FOUND}", file=sys.stderr)
        return 3
    arguments = sys.argv[1:]
    if "--ros-args" in arguments:
        arguments = arguments[:arguments.index("--ros-args")]
    # Its signals and its exit code are those of the program.
    os.execv(path, [path, *command, *arguments])


def any_command():
    return become()


def follow():
    return become("bag", "follow")


def agent():
    return become("robot", "run")


def serve():
    return become("serve")
