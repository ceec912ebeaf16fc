"""Small frames with results, statuses, and a running recorder."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import rigid_transform
from tests.vo_service.fakes import make_status
from tests.vo_service.outputs import sample_updates
from tests.vo_service.outputs.sample_updates import CAMERA, START_S
from tests.waiting import wait_until
from vo_service.config_tables import RecorderConfig
from vo_service.outputs.recorder.client import FlightRecorder
from vo_service.types.commands import CommandError
from vo_service.types.messages import Status, TrackingReport
from vo_service.types.odometry_update import OdometryUpdate, TrackingState, WheelMessageSource

SMALL = RecorderConfig(max_mb=20)
METADATA: Mapping[str, object] = {"versions": {"kinect-vo": "1"}}


def make_frame(seq: int, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    """Make a frame with unique noise, depth holes, 30 Hz stamps, gravity and skew."""
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
    """Make the result of frame `seq`; each pose is one centimeter further."""
    T = rigid_transform(np.eye(3), [0.01 * seq, 0.0, 0.0])
    update = sample_updates.make_update(seq, ok=state is not TrackingState.LOST)
    frame = make_frame(seq, camera)
    return replace(
        update,
        stamp_s=frame.stamp_s + offset_s,
        state=state,
        T_world_camera=T,
        T_odom_base=T,
        T_odom_camera=T,
        frame=frame,
    )


def make_recorder_status(frames: int = 0) -> Status:
    """Make a status with this frame count."""
    return make_status(tracking=TrackingReport("surf", frames=frames))


@contextmanager
def running_recorder(
    state: Path,
    settings: RecorderConfig = SMALL,
    wheel_messages: WheelMessageSource = tuple,
) -> Iterator[FlightRecorder]:
    """Run a flight recorder while the block runs."""
    recorder = FlightRecorder(settings, state, METADATA, wheel_messages)
    try:
        wait_until(lambda: recorder.is_ready, "the recorder's process")
        yield recorder
    finally:
        recorder.close()


def send_updates(recorder: FlightRecorder, *updates: OdometryUpdate) -> None:
    """Send frames no faster than the recorder takes them."""
    for update in updates:
        expected = recorder.frame_count + 1
        recorder.on_update(update)
        wait_until(partial(_has_buffered, recorder, expected), "a frame to be taken")


def _has_buffered(recorder: FlightRecorder, expected: int) -> bool:
    return recorder.frame_count >= expected


def list_incidents(state: Path) -> list[Path]:
    """List the folders of incidents, complete and partial."""
    return sorted(state.glob("incidents/*"))


def wait_for_incident(state: Path, reason: str) -> Path:
    """Wait for the one incident of this kind to be complete."""

    def complete_incidents() -> list[Path]:
        return [path for path in list_incidents(state) if path.name.endswith(reason)]

    wait_until(lambda: bool(complete_incidents()), f"an incident {reason!r}")
    (incident,) = complete_incidents()
    return incident


def save_incident(recorder: FlightRecorder, reason: str) -> Path:
    """Save an incident, wait until it is complete and return its folder."""
    folder = Path(recorder.save(reason))
    wait_until(lambda: not recorder.is_saving, f"{folder}")
    assert folder.exists()
    return folder


def incident_of(state: Path, *updates: OdometryUpdate, settings: RecorderConfig = SMALL) -> Path:
    """Return the folder of an incident with these frames."""
    with running_recorder(state, settings) as recorder:
        send_updates(recorder, *updates)
        return save_incident(recorder, "command")


def command_error(call: Callable[[], object]) -> str:
    """Return the code and the message of a refused command."""
    try:
        call()
    except CommandError as error:
        return f"{error.code}: {error}"
    raise AssertionError("it was not refused")
