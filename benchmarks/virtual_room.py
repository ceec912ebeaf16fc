"""The virtual Kinect for the benchmarks of maps: rendered once, then played from the cache."""

from collections.abc import Iterator
from dataclasses import replace

from benchmarks.camera_frames import read_all_frames
from drivers.camera import PinholeCamera, PlaybackMode, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.paths import cache_folder
from drivers.core.trajectory import Trajectory
from drivers.synthetic.camera import RenderOptions, SyntheticCamera
from drivers.synthetic.config import KINECT_COLOR, SyntheticConfig


def render_with_truth(config: SyntheticConfig) -> Iterator[tuple[RgbdFrame, Array]]:
    """Each frame, and T_world_camera: its true pose in the room."""
    preparation = RenderOptions(cache_folder() / "films")
    with SyntheticCamera(config, PlaybackMode.LOCKSTEP, preparation) as camera:
        truth: Trajectory | None = None
        for frame in read_all_frames(camera):
            truth = truth or camera.ground_truth
            assert truth is not None, "a film that is played once has a truth"
            yield frame, truth.T_world_camera[frame.seq]


def scaled_camera(scale: float) -> PinholeCamera:
    """The virtual Kinect's color camera with images of another size; 1 is 640 x 480."""
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
