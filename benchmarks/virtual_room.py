"""The virtual Kinect for the map benchmarks: rendered once, then read from the cache."""

from collections.abc import Iterator
from dataclasses import replace

from benchmarks.camera_frames import read_all_frames
from drivers.camera import PinholeCamera, PlaybackMode, RgbdFrame
from drivers.core.files import cache_folder
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from drivers.synthetic.camera import RenderOptions, SyntheticCamera
from drivers.synthetic.config import KINECT_COLOR, SyntheticConfig


def render_with_truth(config: SyntheticConfig) -> Iterator[tuple[RgbdFrame, Array]]:
    """Yield each frame and its true pose T_world_camera in the room."""
    render_options = RenderOptions(cache_folder() / "sequences")
    with SyntheticCamera(config, PlaybackMode.LOCKSTEP, render_options) as camera:
        truth: Trajectory | None = None
        for frame in read_all_frames(camera):
            truth = truth or camera.ground_truth
            assert truth is not None, "a sequence without a loop has a ground truth"
            yield frame, truth.T_world_camera[frame.seq]


def scaled_camera(scale: float) -> PinholeCamera:
    """The virtual Kinect's color camera with scaled images; 1 is 640 x 480."""
    whole = KINECT_COLOR
    return replace(
        whole,
        width=round(scale * whole.width),
        height=round(scale * whole.height),
        fx=scale * whole.fx,
        fy=scale * whole.fy,
        cx=scale * (whole.cx + 0.5) - 0.5,
        cy=scale * (whole.cy + 0.5) - 0.5,
    )
