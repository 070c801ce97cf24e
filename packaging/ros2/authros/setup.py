from glob import glob

from setuptools import setup

NAME = "authros_follow"

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
    description="Seals what a recorder writes, while it writes",
    license="Apache-2.0",
    entry_points={"console_scripts": ["follow = authros_follow.follow:main"]},
)
