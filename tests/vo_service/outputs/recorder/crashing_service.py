"""A service process with a recorder, which crashes on request.

``python -P -m tests.vo_service.outputs.recorder.crashing_service STATE HOW`` prints "ready" when
the frames are recorded, then waits for a line. HOW is "segfault", "exit" (while it records) or
anything else to wait for a kill.
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
    """Record frames, then end."""
    with running_recorder(state) as recorder:
        if death == "exit":
            recorder.start_recording("desk")
        recorder.on_status(make_recorder_status(frames=FRAMES))
        send_updates(recorder, *map(make_update, range(FRAMES)))
        print("ready", flush=True)
        sys.stdin.readline()
        match death:
            case "segfault":
                ctypes.string_at(0)
            case "exit":
                os._exit(3)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
