"""What each odometry method makes of fixed input: a digest of every bit, and the rough path.

The bits depend on the processor and on the versions of the libraries, so the file says which it was
written with. Elsewhere the rough path is compared instead.

Write the file anew, after a change that is meant to change poses: ``python -m
tests.golden.trajectories``.
"""

# As the program has it, and before numpy.
import vo_service.tools.compare.single_thread  # noqa: F401

# isort: split

import hashlib
import json
import os
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import llvmlite.binding
import numpy as np

from drivers.camera import PinholeCamera, PlaybackMode, RgbdCamera
from drivers.playback.camera import RecordingCamera
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from vo_service.app import run_replay
from vo_service.config import Config, OdometryConfig
from vo_service.frame_source import FrameSource
from vo_service.odometry.registry import METHODS
from vo_service.signals import StopSignal
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate

FILE = Path(__file__).with_name("trajectories.json")
FRAMES = 60
# The rough path has every tenth position.
STRIDE = 10
HALF_SIZE = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)
VIRTUAL = replace(
    SyntheticConfig(), camera=HALF_SIZE, duration_s=FRAMES / 10.0, rate_hz=10.0, texel_m=0.005
)
RECORDINGS = ("redkitchen", "room_rolling")
SOURCES = ("virtual", *RECORDINGS)
CASES = tuple(f"{method}-{source}" for method, source in product(METHODS, SOURCES))


@dataclass
class PoseDigest:
    """Takes the first poses, as an output of the service, and then asks for the end."""

    stop: StopSignal
    warning = ""
    bits: "hashlib._Hash" = field(default_factory=hashlib.sha256)
    states: dict[str, int] = field(default_factory=dict)
    path_m: list[list[float]] = field(default_factory=list)

    def on_update(self, update: OdometryUpdate) -> None:
        numbers = (
            update.T_world_camera,
            update.T_odom_base,
            update.T_odom_camera,
            update.pose_covariance,
            update.twist,
            update.twist_covariance,
        )
        for array in numbers:
            self.bits.update(np.ascontiguousarray(array, np.float64).tobytes())
        self.bits.update(f"{update.seq} {update.stamp_s!r} {update.state} {update.epoch}".encode())
        self.states[update.state] = self.states.get(update.state, 0) + 1
        if update.seq % STRIDE == STRIDE - 1:
            self.path_m.append([round(float(x), 4) for x in update.T_world_camera[:3, 3]])
        if update.seq == FRAMES - 1:
            self.stop.request()

    def on_status(self, status: Status) -> None:
        """A status has times in it, which differ."""

    def close(self) -> None:
        """There is nothing to finish."""

    @property
    def result(self) -> dict[str, Any]:
        return {"sha256": self.bits.hexdigest(), "states": self.states, "path_m": self.path_m}


def compute_digest(case: str, rendered: Path) -> dict[str, Any]:
    """Run a method over its input. A recording is found through KINECT_VO_DATA.

    `rendered` is the folder for frames of the virtual Kinect.
    """
    method, source = case.split("-", 1)
    config = replace(Config(), odometry=OdometryConfig(method=method))
    digest = PoseDigest(StopSignal())
    with _camera(source, rendered) as camera:
        run_replay(config, camera, FrameSource(camera), [digest], digest.stop)
    return digest.result


def _camera(source: str, rendered: Path) -> RgbdCamera:
    if source == "virtual":
        return SyntheticCamera(VIRTUAL, rendered)
    return RecordingCamera(Path(os.environ["KINECT_VO_DATA"]) / source, None, PlaybackMode.LOCKSTEP)


def environment_info() -> dict[str, str]:
    """What the bits of a result depend on, beside the code."""
    libraries = ("numpy", "opencv-python-headless", "numba", "scipy")
    return {
        "processor": str(llvmlite.binding.get_host_cpu_name()),
        "features": hashlib.sha256(_processor_features().encode()).hexdigest()[:16],
        **{library: version(library) for library in libraries},
    }


def _processor_features() -> str:
    features = llvmlite.binding.get_host_cpu_features()
    return ",".join(sorted(name for name, is_there in features.items() if is_there))


if __name__ == "__main__":
    with TemporaryDirectory() as rendered:
        results = {case: compute_digest(case, Path(rendered)) for case in CASES}
    content = {"made_with": environment_info(), "trajectories": results}
    FILE.write_text(json.dumps(content, indent=1) + "\n")
