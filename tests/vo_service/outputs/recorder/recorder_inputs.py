"""Small frames with what the service said of them, statuses, and a recorder to give them to."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import rigid_transform
from tests.vo_service.fakes import make_status
from tests.waiting import wait_until
from vo_service.config_tables import RecorderConfig
from vo_service.outputs.recorder.flight_recorder import FlightRecorder
from vo_service.types import CommandError, Estimate, OdometryUpdate, Status, TrackingState

CAMERA = PinholeCamera(width=64, height=48, fx=60.0, fy=60.0, cx=31.5, cy=23.5)
START_S = 1305031453.359684
METADATA: Mapping[str, object] = {"versions": {"kinect-vo": "1"}}


def make_frame(seq: int, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    """Noise that no other frame has, depth with holes, 30 a second, gravity and a skew."""
    random = np.random.default_rng(seq)
    shape = (camera.height, camera.width)
    depth = random.integers(1990, 2010, shape, np.uint16)
    depth[random.random(shape) < 0.1] = 0
    return RgbdFrame(
        seq=seq,
        stamp_s=START_S + seq / 30,
        receive_time_s=0.0,
        color_bgr=random.integers(0, 255, (*shape, 3), np.uint8),
        depth_raw=depth,
        depth_factor=1000.0,
        camera=camera,
        skew_s=0.004,
        gravity_m_s2=(0.1, 9.7, 0.2),
        readout_s=0.019,
    )


def make_update(
    seq: int,
    state: TrackingState = TrackingState.TRACKING,
    *,
    offset_s: float = 0.0,
    camera: PinholeCamera = CAMERA,
) -> OdometryUpdate:
    """What the service says of frame `seq`: a centimetre further than the one before."""
    T = rigid_transform(np.eye(3), [0.01 * seq, 0.0, 0.0])
    is_lost = state is TrackingState.LOST
    picture = make_frame(seq, camera)
    return OdometryUpdate(
        seq=seq,
        stamp_s=picture.stamp_s + offset_s,
        state=state,
        reason="too few matches" if is_lost else "",
        epoch=1,
        T_world_camera=T,
        T_odom_base=T,
        T_odom_camera=T,
        pose_covariance=np.eye(6),
        twist=np.zeros(6),
        twist_covariance=np.eye(6),
        frame=picture,
        estimate=Estimate(not is_lost, "", T, np.eye(4), np.eye(6), 20, 10, 7),
        stage_ms={},
        latency_s=0.01,
    )


def make_recorder_status(frames: int = 0) -> Status:
    """A status that has counted so many frames."""
    return make_status(frames=frames)


@contextmanager
def running_recorder(
    state: Path, settings: RecorderConfig | None = None
) -> Iterator[FlightRecorder]:
    """A flight recorder that is up; closed at the end."""
    opened = FlightRecorder(settings or RecorderConfig(max_mb=20), state, METADATA)
    try:
        wait_until(lambda: opened.is_ready, "the recorder's process")
        yield opened
    finally:
        opened.close()


def send_updates(recorder: FlightRecorder, *updates: OdometryUpdate) -> None:
    """Give it frames no faster than it takes them."""
    for one in updates:
        expected = recorder.frame_count + 1
        recorder.on_update(one)
        wait_until(partial(_has_buffered, recorder, expected), "a frame to be taken")


def _has_buffered(recorder: FlightRecorder, expected: int) -> bool:
    return recorder.frame_count >= expected


def list_incidents(state: Path) -> list[Path]:
    """Folders of incidents, whole ones and begun ones."""
    return sorted(state.glob("incidents/*"))


def wait_for_incident(state: Path, reason: str) -> Path:
    """The one incident of this kind, as soon as it is whole."""

    def whole() -> list[Path]:
        return [path for path in list_incidents(state) if path.name.endswith(reason)]

    wait_until(lambda: bool(whole()), f"an incident {reason!r}")
    (found,) = whole()
    return found


def save_incident(recorder: FlightRecorder, reason: str) -> Path:
    """The folder of an incident that has been asked for, when it is whole."""
    folder = Path(recorder.save(reason))
    wait_until(lambda: not recorder.is_saving, f"{folder}")
    assert folder.exists()
    return folder


def command_error(of: Callable[[], object]) -> str:
    """The code and the words with which a command is refused."""
    try:
        of()
    except CommandError as error:
        return f"{error.code}: {error}"
    raise AssertionError("it was not refused")
