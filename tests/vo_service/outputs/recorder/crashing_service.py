"""A service in a process of its own, as far as the recorder knows: it dies as it is told.

``python -P -m tests.vo_service.outputs.recorder.crashing_service STATE HOW``; prints "ready" when frames
are remembered, then waits for a line. HOW is "segfault", "exit" (while it records) or anything else
for one that waits to be killed.
"""

import ctypes
import os
import sys
from pathlib import Path

from tests.vo_service.outputs.recorder.recorder_inputs import (
    make_recorder_status,
    make_update,
    running_recorder,
    send_updates,
)

FRAMES = 10


def main(state: Path, death: str) -> None:
    """Remember frames, then end."""
    with running_recorder(state) as opened:
        if death == "exit":
            opened.start_recording("desk")
        opened.on_status(make_recorder_status(frames=FRAMES))
        send_updates(opened, *map(make_update, range(FRAMES)))
        print("ready", flush=True)
        sys.stdin.readline()
        match death:
            case "segfault":
                ctypes.string_at(0)
            case "exit":
                os._exit(3)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
