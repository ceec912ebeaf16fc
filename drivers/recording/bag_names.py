"""Names of the files of bags."""

# A ROS 1 bag is .active until it is closed; `ros2 bag record --compression-mode file` adds .zstd.
BAG_ENDINGS = (".mcap", ".bag", ".db3", ".mcap.zstd", ".db3.zstd", ".bag.active")


def is_bag_file(name: str) -> bool:
    """Whether a file's name is that of an MCAP file or a ROS bag."""
    return name.lower().endswith(BAG_ENDINGS)
