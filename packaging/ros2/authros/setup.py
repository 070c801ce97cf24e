from glob import glob

from setuptools import setup

NAME = "authros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The AuthROS authors",
    maintainer_email="authros@example.invalid",
    description="Starts AuthROS from ROS 2: seals recordings, captures for a gateway, serves a site",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "authros = authros.program:any_command",
            "follow = authros.program:follow",
            "agent = authros.program:agent",
            "serve = authros.program:serve",
        ]
    },
)
