"""What each field of the status means, in words: for its JSON Schema and for the documentation."""

from collections.abc import Mapping

STATUS_FIELDS: Mapping[str, str] = {
    "state": "how far the pose can be trusted",
    "reason": 'why the state is so, in words; "" while all is well',
    "epoch": "changes whenever the pose is not continuous with the one before",
    "camera": "name of the camera",
    "camera_state": "how far the camera is from sending frames",
    "intrinsics": 'where they come from: "camera file FILE", "factory", "default"; "" = exact',
    "level": "how it is known which way is up: measured, or the first pose counts as level",
    "method": "name of the odometry",
    "fps": "poses a second, of the last two seconds",
    "latency_p50_ms": "from a frame's arrival to its pose, median of the last 100 frames",
    "latency_p99_ms": "the same, 99th percentile",
    "skew_ms": "instant of depth minus instant of colour, median of the last 100 frames",
    "jitter_ms": "standard deviation of the time from one stamp to the next",
    "features": "found in the last frame",
    "matches": "of them, with the frame before",
    "inliers": "of them, that agree on one motion",
    "frames": "frames through the odometry since the start",
    "failed": "of them, without a motion found",
    "dropped": "frames left out because a newer one was there",
    "skipped": "frames left out because they could not be used",
    "lost_packets": "packets that the sensor sent and that did not arrive",
    "paused": "asked to publish no poses",
    "recording": 'folder that is being recorded into; "" = none',
    "warnings": "what is wrong beside the tracking, one clause each",
    "cpu_ms_per_frame": "processor time of the odometry, median of the last 100 frames",
    "stage_ms": "the same by stage",
    "versions": "of the program, of Python and of the libraries that make the poses",
}
