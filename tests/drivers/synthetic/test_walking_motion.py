"""A walk several times past the same places, and two corners that look the same."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from drivers.core import InputError
from drivers.core.geometry import Array, rotation_angle_rad
from drivers.synthetic.camera_motion import CameraMotion, look_rotations
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.furniture import Solids
from drivers.synthetic.human_motion import TourMotion
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.synthetic.room import HALF_TURN, ROOM_HEIGHT_M, build_room
from drivers.synthetic.solids import Solid
from tests.drivers.synthetic.conftest import IDEAL

TOUR = SyntheticConfig(motion=MotionKind.TOUR, duration_s=60.0)


def tour(seconds: float, seed: int = 1) -> tuple[Array, Array]:
    """Times (N,) and poses (N, 4, 4), thirty per second."""
    times_s = np.arange(round(30 * seconds)) / 30.0
    config = replace(TOUR, duration_s=seconds, seed=seed)
    return times_s, make_motion(config, ROOM_HEIGHT_M).poses(times_s)


def around_rad(poses: Array) -> Array:
    """Unwrapped angle (N,) about the middle of the room."""
    return np.unwrap(np.arctan2(poses[:, 1, 3] / 1.8, poses[:, 0, 3] / 2.6))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_in_a_minute_it_passes_every_place_twice_at_the_speed_of_a_hand_or_a_robot(
    seed: int,
) -> None:
    _, poses = tour(60.0, seed)
    assert np.ptp(around_rad(poses)) == pytest.approx(4 * np.pi, abs=0.2)
    speed_m_s = 30.0 * np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert 0.2 < np.percentile(speed_m_s, 2) < np.percentile(speed_m_s, 95) < 0.7
    turns = np.linalg.solve(poses[:-1], poses[1:])[:, :3, :3]
    rates = np.degrees([30.0 * rotation_angle_rad(turn) for turn in turns])
    assert 10.0 < np.median(rates) < np.percentile(rates, 95) < 40.0


def test_in_ten_minutes_it_makes_many_laps_and_sometimes_goes_back() -> None:
    _, poses = tour(600.0)
    around = around_rad(poses)
    assert around[-1] - around[0] == pytest.approx(14 * 2 * np.pi, abs=0.1)
    is_back = np.diff(np.convolve(around, np.ones(60) / 60, "valid")) < 0
    assert np.count_nonzero(np.diff(is_back.astype(int)) == 1) == 6
    assert np.count_nonzero(is_back) / 30.0 == pytest.approx(6 * 15.0, rel=0.1)


def test_it_looks_where_it_goes_on_and_back() -> None:
    times_s, poses = tour(90.0)
    velocity_m_s = np.gradient(poses[:, :2, 3], times_s, axis=0)
    forwards = np.sum(velocity_m_s * poses[:, :2, 2], axis=1)
    assert np.mean(forwards > 0.0) > 0.9
    assert np.diff(around_rad(poses)).min() < -0.005


def test_a_place_is_never_seen_from_the_same_pose_on_another_lap() -> None:
    _, poses = tour(60.0)
    one, two = poses[:900], poses[900:]
    apart_m = np.linalg.norm(one[:, None, :3, 3] - two[None, :, :3, 3], axis=2)
    nearest = apart_m.argmin(axis=1)
    assert apart_m.min(axis=1).max() < 0.5
    turns = np.linalg.solve(one, two[nearest])[:, :3, :3]
    angles_deg = np.degrees([rotation_angle_rad(turn) for turn in turns])
    assert 3.0 < np.median(angles_deg) < 40.0


class StationaryMotion(CameraMotion):
    """A camera that does not move."""

    def __init__(self, T_world_camera: Array) -> None:
        self._T = T_world_camera

    def poses(self, times_s: Array) -> Array:
        return np.tile(self._T, (len(times_s), 1, 1))


def looking(towards_rad: float) -> Array:
    """T_world_camera from near the middle of the room, turned left of +y."""
    T = np.eye(4)
    T[:3, :3] = look_rotations(np.array([towards_rad]), np.array([0.25]), np.zeros(1))[0]
    T[:3, 3] = (-0.7 * np.sin(towards_rad), 0.7 * np.cos(towards_rad), 1.4)
    return T


@pytest.mark.slow
def test_two_corners_look_the_same_and_the_other_two_do_not() -> None:
    config = replace(IDEAL, twin_corners=True, texel_m=0.03)
    room = RoomModel.build(config, make_motion(config, ROOM_HEIGHT_M), threads=2)

    def unlike(T: Array) -> tuple[float, float]:
        """Mean difference of color and fraction of other depths, from T and from its opposite."""
        a, b = (
            Renderer(config, StationaryMotion(each), room).render(0) for each in (T, HALF_TURN @ T)
        )
        return float(np.mean(cv2.absdiff(a.color_bgr, b.color_bgr))), float(
            np.mean(a.depth_raw != b.depth_raw)
        )

    twins, others = unlike(looking(-0.75)), unlike(looking(0.75))
    assert twins[0] < 1.0 < 10.0 < others[0]
    assert twins[1] < 0.01 < 0.3 < others[1]


def test_every_piece_of_an_aliased_corner_has_its_copy_opposite() -> None:
    free_m = TourMotion(np.random.default_rng(1), 60.0).clearance_points_m(
        np.linspace(0.0, 60.0, 600)
    )
    plain, twins = (build_room(1, free_m, bare_wall=False, twin_corners=on) for on in (False, True))
    # The shell of the room is symmetric.
    assert count_of_pairs(plain[1:]) == 0
    assert count_of_pairs(twins[1:]) > 20


def count_of_pairs(solids: Solids) -> int:
    """Count pieces that have one of the same size at the opposite place."""
    keys = {key(solid) for solid in solids}
    return sum(key(solid.transform(HALF_TURN)) in keys for solid in solids) // 2


def key(solid: Solid) -> tuple[float, ...]:
    """Place and size, to a millimeter."""
    return tuple(np.round([*solid.T_world_solid[:3, 3], *solid.half_m], 3) + 0.0)


def test_aliased_corners_need_all_four_walls() -> None:
    with pytest.raises(InputError, match="twin_corners needs all four walls"):
        SyntheticConfig(twin_corners=True, bare_wall=True)
