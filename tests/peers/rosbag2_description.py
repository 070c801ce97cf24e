"""The description that rosbag2 writes last into the folder of a recording."""

import os


def write(folder, storage, files, messages):
    """For a recording of this many files, named after the folder, with this storage: mcap or db3."""
    name = os.path.basename(folder)
    identifier = {"mcap": "mcap", "db3": "sqlite3"}[storage]
    names = "".join(f"    - {name}_{number}.{storage}\n" for number in range(files))
    with open(os.path.join(folder, "metadata.yaml"), "w") as description:
        description.write(
            f"rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: {identifier}\n  relative_file_paths:\n{names}"
            f"  starting_time:\n    nanoseconds_since_epoch: 1790000000000000000\n  message_count: {messages}\n"
        )
