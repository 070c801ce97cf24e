"""Captures the topics of a robot's enrolment and forwards them to its gateway, without the owner's keys.

    ros2 launch authros agent.launch.py enrolment:=/data/scout-1.enrolment passphrase_file:=/data/scout-1.passphrase
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    enrolment = DeclareLaunchArgument("enrolment", description="the robot's enrolment file")
    passphrase = DeclareLaunchArgument("passphrase_file", description="a file with the enrolment's passphrase")
    # In the domain of ROS_DOMAIN_ID, as all nodes of this launch.
    arguments = [LaunchConfiguration("enrolment"), "--passphrase-file", LaunchConfiguration("passphrase_file"), "--ros2"]
    agent = Node(package="authros", executable="agent", arguments=arguments, output="screen", sigterm_timeout="20")
    return LaunchDescription([enrolment, passphrase, agent])
