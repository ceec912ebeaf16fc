"""The reader of a fleet: one wildcard subscriber that measures the age of each pose.

    python -m benchmarks fleet_reader ZENOH_FILE

It prints "ready" once it subscribes. After "end" on standard input it prints the latencies in
milliseconds as a JSON list, one for each pose of each robot.
"""

import json
import sys
import time
from pathlib import Path

import zenoh

from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session
from vo_service.ros_messages.navigation import decode_odometry


def main(file: Path) -> None:
    """Subscribe until the end; see the module."""
    latency_ms: dict[tuple[str, int], float] = {}

    def take(sample: zenoh.Sample) -> None:
        stamp_s = decode_odometry(sample.payload.to_bytes()).stamp_s
        received_s = time.monotonic()
        attachment = sample.attachment
        assert attachment is not None
        seq = json.loads(attachment.to_bytes())["seq"]
        latency_ms.setdefault((str(sample.key_expr), seq), 1e3 * (received_s - stamp_s))

    config = ZenohConfig(config_file=file, listen=())
    with open_session(config) as session, session.declare_subscriber("*/odom", take):
        print("ready", flush=True)
        sys.stdin.readline()
    print(json.dumps(list(latency_ms.values())), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
