"""A simulated base: its motion, and the camera on it."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import Clock, FrameTimeout, PinholeCamera, PlaybackMode, RgbdCamera
from drivers.core import CameraError, CameraLostError, InputError
from drivers.faulty_camera import Fault, FaultKind
from drivers.synthetic.camera import make_synthetic_camera
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.driven_motion import DrivenMotion
from drivers.synthetic.room import build_room
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("unpainted")

CONFIG = replace(
    SyntheticConfig.fast(),
    camera=PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5),
    motion=MotionKind.DRIVEN,
    texel_m=0.05,
)


def place(motion: DrivenMotion, time_s: float) -> tuple[float, float, float]:
    """x, y and yaw of the camera; yaw 0 faces +y."""
    (T,) = motion.poses(np.array([time_s]))
    return T[0, 3], T[1, 3], math.atan2(-T[0, 2], T[1, 2])


def open_driven(config: SyntheticConfig = CONFIG) -> RgbdCamera:
    return make_synthetic_camera(config, Path("unused"), PlaybackMode.REALTIME)


def test_a_circle_ends_where_it_began() -> None:
    motion, period_s = DrivenMotion(CONFIG), 2 * math.pi / 0.5
    for time_s in np.arange(0.0, period_s, 0.1):
        motion.drive(time_s, 0.3, 0.5)
    motion.drive(period_s, 0.0, 0.0)
    assert place(motion, period_s / 2) == pytest.approx((-1.2, 0.0, math.pi), abs=1e-9)
    assert place(motion, period_s + 9.0) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_it_stops_half_a_second_after_the_last_command() -> None:
    motion = DrivenMotion(CONFIG)
    motion.drive(1.0, 0.4, 0.0)
    assert [place(motion, time_s)[1] for time_s in (0.5, 1.0, 1.25, 1.5, 9.0)] == pytest.approx(
        [0.0, 0.0, 0.1, 0.2, 0.2]
    )


def test_velocities_are_limited() -> None:
    motion = DrivenMotion(CONFIG)
    motion.drive(0.0, -50.0, 0.0)
    motion.drive(0.1, 0.0, 50.0)
    assert place(motion, 0.2) == pytest.approx((0.0, -0.1, 0.2))


def test_the_camera_is_mounted_as_configured() -> None:
    motion = DrivenMotion(replace(CONFIG, camera_height_m=0.7, pitch_down_deg=30.0))
    (T,) = motion.poses(np.zeros(1))
    np.testing.assert_allclose(T[:3, 3], (0.0, 0.0, 0.7))
    np.testing.assert_allclose(T[:3, 2], (0.0, math.sqrt(0.75), -0.5))


def test_the_room_is_clear_around_the_start() -> None:
    points_m = DrivenMotion(CONFIG).clearance_points_m(np.zeros(1))
    _, *furniture = build_room(1, points_m, bare_wall=False, twin_corners=False)
    assert furniture
    for solid in furniture:
        x_m, y_m, z_m = solid.T_world_solid[:3, 3]
        assert max(abs(x_m), abs(y_m)) > 1.5 or z_m > 1.0


def test_the_frames_show_the_drive_and_the_ground_truth_tells_it() -> None:
    camera = open_driven()
    with camera:
        frame = camera.read(100.0)
        assert (camera.clock, camera.can_drive) == (Clock.MONOTONIC, True)

        def has_driven() -> bool:
            camera.set_velocity(1.0, 0.0)
            newest = camera.read(10.0)
            depth_m = [np.median(each.depth_m[each.depth_m > 0]) for each in (frame, newest)]
            return bool(depth_m[1] < depth_m[0] - 0.3)

        wait_until(has_driven)
    truth = camera.ground_truth
    assert truth is not None
    assert truth.stamps_s[0] == frame.stamp_s
    assert len(truth) == camera.counters.delivered
    assert truth.T_world_camera[-1][1, 3] > 0.3


def test_late_frames_are_dropped_and_counted() -> None:
    with open_driven() as camera:
        first = camera.read(100.0)
        time.sleep(0.5)
        late, newest = camera.read(1.0), camera.read(1.0)
    assert late.seq > first.seq + 2
    assert newest.seq > late.seq
    dropped = newest.seq + 1 - camera.counters.delivered
    assert camera.counters.dropped == dropped > 0


def test_after_it_is_opened_again_it_drives_on() -> None:
    with open_driven() as camera:
        first = camera.read(100.0)
        camera.close()
        with pytest.raises(CameraLostError, match="not open"):
            camera.read(1.0)
        camera.open()
        again = camera.read(10.0)
        assert again.seq > first.seq


def test_until_its_room_is_painted_no_frame_comes() -> None:
    with open_driven() as camera:
        assert camera.status.no_frame_reason == "starting: preparing its room"
        with pytest.raises(FrameTimeout):
            camera.read(0.0)


def test_a_velocity_that_is_no_number_is_refused() -> None:
    with pytest.raises(InputError, match="not finite"):
        open_driven().set_velocity(math.nan, 0.0)


def test_a_replay_and_another_motion_cannot_be_driven(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nobody drives a replay"):
        make_synthetic_camera(CONFIG, tmp_path)
    still = make_synthetic_camera(replace(CONFIG, motion=MotionKind.STILL), tmp_path)
    assert not still.can_drive
    with pytest.raises(CameraError, match="not on a base"):
        still.set_velocity(0.1, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"track": Path("track.txt")}, "track cannot be followed"),
        ({"faults": (Fault(FaultKind.UNPLUGGED, 1, seconds=1.0),)}, "faults cannot unplug"),
    ],
)
def test_what_a_driven_base_cannot_do_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(CONFIG, **change)  # type: ignore[arg-type]


def test_other_faults_are_injected() -> None:
    with open_driven(replace(CONFIG, faults=(Fault(FaultKind.BLACK, 0, 10**6),))) as camera:
        assert camera.can_drive
        camera.set_velocity(0.0, 0.0)
        assert not camera.read(100.0).color_bgr.any()


def test_no_frame_is_late_before_the_camera_is_opened() -> None:
    camera = open_driven()
    camera.prepare()
    time.sleep(1.0)
    with camera:
        assert camera.read(100.0).seq < 10
