"""A subscriber that uses only the `zenoh` package and nothing of this project.

Usage: plain_zenoh_reader.py PORT COUNT SECONDS_PER_SAMPLE. Prints "ready", then one JSON line.
"""

import json
import sys
import threading
import time

import zenoh

port, count, seconds_per_sample = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
config.insert_json5("connect/timeout_ms", "-1")  # wait for the publisher
config.insert_json5("scouting/multicast/enabled", "false")  # may fail without IPv6
samples: list[dict[str, object]] = []
done = threading.Event()


def on_sample(sample: zenoh.Sample) -> None:
    time.sleep(seconds_per_sample)  # a slow reader
    attachment = sample.attachment
    samples.append(
        {
            "payload": sample.payload.to_bytes().hex(),
            "encoding": str(sample.encoding),
            "attachment": json.loads(attachment.to_bytes()) if attachment else None,
        }
    )
    if len(samples) == count:
        done.set()


with zenoh.open(config) as session, session.declare_subscriber("*/odom", on_sample):
    print("ready", flush=True)
    done.wait(timeout=100)
print(json.dumps(samples))
