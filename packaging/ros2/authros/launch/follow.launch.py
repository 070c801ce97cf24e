"""Seals what is recorded into a folder, while it is recorded.

    ros2 launch authros follow.launch.py folder:=/data/run1
    ros2 bag record --storage mcap --all --output /data/run1
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

OPTIONS = {
    "until_closed": ("--until-closed", "end when the recording is closed and its proofs are written"),
}


def start(context):
    def said(name):
        return LaunchConfiguration(name).perform(context)

    options = [word for name, (word, _) in OPTIONS.items() if said(name).lower() in ("true", "1", "yes")]
    # On its end, what it has read is still stored.
    return [Node(package="authros", executable="follow", arguments=[said("folder"), *options], output="screen", sigterm_timeout="20")]


def generate_launch_description():
    folder = DeclareLaunchArgument("folder", description="the folder into which ros2 bag record writes")
    options = [
        DeclareLaunchArgument(name, default_value="false", description=text) for name, (_, text) in OPTIONS.items()
    ]
    return LaunchDescription([folder, *options, OpaqueFunction(function=start)])
