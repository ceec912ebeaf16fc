"""Read poses, status and the latest pose with the `zenoh` package only, without kinect-vo.

Usage: python plain_zenoh.py [ENDPOINT]
"""

import json
import signal
import struct
import sys

import zenoh

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end without an error in `| head`
endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"
settings = {
    "mode": "peer",
    "connect": {"endpoints": [endpoint]},
    "listen": {"endpoints": []},  # Zenoh's own default is every interface
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
}


def text_at(body: bytes, offset: int) -> tuple[str, int]:
    """Decode a CDR string: its length (aligned to 4 bytes), the text, a zero byte."""
    offset += -offset % 4
    (length,) = struct.unpack_from("<I", body, offset)
    end = offset + 4 + length
    return body[offset + 4 : end - 1].decode(), end


def show(sample: zenoh.Sample) -> None:
    """Decode nav_msgs/msg/Odometry: 4 bytes of header, then the fields in order."""
    attachment = json.loads(sample.attachment.to_bytes()) if sample.attachment else {}
    body = sample.payload.to_bytes()[4:]
    seconds, nanoseconds = struct.unpack_from("<iI", body)
    frame, offset = text_at(body, 8)
    child, offset = text_at(body, offset)
    numbers = struct.unpack_from("<85d", body, offset + -offset % 8)
    position, quaternion, covariance = numbers[:3], numbers[3:7], numbers[7:43]
    twist = numbers[43:49]
    print(f"{seconds}.{nanoseconds:09d} {frame}->{child} at {position} turned {quaternion}")
    print(
        f"  variance of x {covariance[0]:.2e} m2, speed {twist[0]:.3f} m/s, {attachment}",
        flush=True,
    )


try:
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as session:
        states = [reply.ok for reply in session.get("kinect/status", timeout=2.0) if reply.ok]
        for state in states:
            print("status:", json.loads(state.payload.to_bytes())["state"], flush=True)
        if not states:
            print(f"no service at {endpoint}; waiting for one", file=sys.stderr)
        for reply in session.get("kinect/latest", timeout=2.0):
            if reply.err:
                print("latest:", json.loads(reply.err.payload.to_bytes())["message"], flush=True)
        subscriber = session.declare_subscriber("kinect/odom")
        for sample in subscriber:
            show(sample)
except (KeyboardInterrupt, zenoh.ZError) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
