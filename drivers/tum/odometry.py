"""The file of a TUM folder with the odometry of a base's wheels."""

import base64
from collections.abc import Iterator
from pathlib import Path

from drivers.core import InputError
from drivers.tum.index_files import read_rows

ODOMETRY_FILE = "wheel_odom.txt"
# The message in base64 has all that the driver has sent, bit for bit.
ODOMETRY_COLUMNS = "timestamp message"


def read_odometry(folder: Path) -> Iterator[bytes]:
    """Yield the messages of a folder, CDR ``nav_msgs/msg/Odometry``; none without the file.

    Raises:
        InputError: The file does not parse; the message names file and line.
    """
    path = folder / ODOMETRY_FILE
    for number, (_, text) in read_rows(path, ODOMETRY_COLUMNS) if path.exists() else []:
        try:
            message = base64.b64decode(text, validate=True)
        except ValueError as error:
            raise InputError(
                f"{path}:{number}: {error}; expected {ODOMETRY_COLUMNS}, in base64"
            ) from error
        yield message


def format_message(message: bytes) -> str:
    """Format a line without its stamp, which `read_odometry` reads."""
    return base64.b64encode(message).decode()
