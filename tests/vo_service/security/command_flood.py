"""Sends as many commands as possible without waiting for replies.

Usage: command_flood.py ZENOH_FILE SECONDS. Prints the number of commands.
"""

import sys
import time
from pathlib import Path

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

file, seconds = Path(sys.argv[1]), float(sys.argv[2])
sent = 0
with open_session(ZenohConfig(config_file=file, listen=())) as session:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        session.get("kinect/command/reset", lambda reply: None, payload=b"{}", timeout=1.0)
        sent += 1
print(sent)
