import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import EndOfStream, Pace, RgbdFrame
from drivers.geometry import (
    Array,
    inverse,
    is_rigid,
    rigid_transform,
    rotation_angle_rad,
    rotation_from_vector,
)
from drivers.tum.camera import TumCamera
from tests.vo_service.odometry.synthetic_views import (
    CAMERA,
    FIRST_CALL_COMPILES,
    frame_of,
    view_of_a_corner,
)
from vo_service.odometry.estimate import Estimate
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.surf_odometry import SurfOdometry, SurfParameters

SHAPE = (CAMERA.height, CAMERA.width)
BLACK = frame_of(np.zeros(SHAPE, np.uint8), np.full(SHAPE, 1.5))


def path(n: int) -> list[Array]:
    """Poses of a hand-held camera: 15 mm and 0.8 degrees a frame."""
    turn, shift = np.array([0.006, -0.010, 0.008]), np.array([0.010, -0.005, 0.011])
    return [rigid_transform(rotation_from_vector(k * turn), k * shift) for k in range(n)]


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [view_of_a_corner(T, seq) for seq, T in enumerate(path(6))]


def follow(odometry: SurfOdometry, frames: list[RgbdFrame]) -> list[Estimate]:
    return [odometry.estimate(frame) for frame in frames]


def assert_close(T: Array, expected: Array, metres: float, degrees: float) -> None:
    error = inverse(T) @ expected
    assert np.linalg.norm(error[:3, 3]) < metres
    assert np.degrees(rotation_angle_rad(error[:3, :3])) < degrees


def test_a_camera_in_a_known_scene_is_followed(views: list[RgbdFrame]) -> None:
    poses = path(len(views))
    for k, estimate in enumerate(follow(SurfOdometry(), views)):
        assert estimate.ok, estimate.reason
        assert_close(estimate.T_world_camera, poses[k], 0.002 * (1 + k), 0.1 * (1 + k))


def test_poses_are_the_product_of_the_motions(views: list[RgbdFrame]) -> None:
    T = np.eye(4)
    for estimate in follow(SurfOdometry(), views):
        T = T @ estimate.T_reference_camera
        assert np.array_equal(estimate.T_world_camera, T)


def test_the_first_frame_is_the_world(views: list[RgbdFrame]) -> None:
    first = SurfOdometry().estimate(views[0])
    assert first.ok
    assert not first.restarted
    assert np.array_equal(first.T_world_camera, np.eye(4))
    assert not first.covariance.any()
    assert (first.matches, first.inliers) == (0, 0)


def test_an_estimate_says_what_it_rests_on(views: list[RgbdFrame]) -> None:
    estimate = follow(SurfOdometry(), views[:2])[1]
    evidence = estimate.evidence
    assert 15 <= estimate.inliers <= estimate.matches <= estimate.features <= 1000
    assert evidence.keypoints_px.shape == (estimate.features, 2)
    assert evidence.matches_px.shape == evidence.reference_matches_px.shape
    assert evidence.inlier.shape == (estimate.matches,)
    assert int(evidence.inlier.sum()) == estimate.inliers
    assert np.linalg.eigvalsh(estimate.covariance).min() > 0


def test_the_error_is_of_the_size_that_the_covariance_says(views: list[RgbdFrame]) -> None:
    poses = path(len(views))
    for k, estimate in enumerate(follow(SurfOdometry(), views)[1:], 1):
        error = inverse(estimate.T_reference_camera) @ inverse(poses[k - 1]) @ poses[k]
        sigma_m = np.sqrt(np.trace(estimate.covariance[:3, :3]))
        assert np.linalg.norm(error[:3, 3]) < 4 * sigma_m
        assert sigma_m < 0.005


def test_the_same_frames_twice_give_the_same_bits(views: list[RgbdFrame]) -> None:
    first, second = (follow(SurfOdometry(), views) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a.T_world_camera, b.T_world_camera)
        assert np.array_equal(a.covariance, b.covariance)


def test_the_number_of_threads_changes_no_bit() -> None:
    script = str(Path(__file__).with_name("trajectory_bits.py"))
    root = str(Path(__file__).parents[3])
    digests = set()
    for threads in ("1", "2"):
        environment = os.environ | {"OPENBLAS_NUM_THREADS": threads, "PYTHONPATH": root}
        run = subprocess.run(
            [sys.executable, script, threads],
            env=environment, capture_output=True, text=True, check=True, timeout=100,
        )  # fmt: skip
        digests.add(run.stdout)
    assert len(digests) == 1


def test_a_black_start_is_an_answer_and_the_next_good_frame_begins(views: list[RgbdFrame]) -> None:
    black, first, second = follow(SurfOdometry(), [BLACK, views[0], views[1]])
    assert not black.ok
    assert "too few features with depth" in black.reason
    assert first.ok
    assert np.array_equal(first.T_world_camera, np.eye(4))
    assert_close(second.T_world_camera, path(2)[1], 0.004, 0.2)


def test_a_failed_frame_holds_the_pose_and_is_left_out_of_the_chain(
    views: list[RgbdFrame],
) -> None:
    _, before, failed, after = follow(SurfOdometry(), [views[0], views[1], BLACK, views[3]])
    assert not failed.ok
    assert "0 of 0 matches agree" in failed.reason
    assert np.array_equal(failed.T_world_camera, before.T_world_camera)
    assert np.array_equal(failed.T_reference_camera, np.eye(4))
    assert not failed.restarted
    assert after.ok
    assert_close(after.T_world_camera, path(4)[3], 0.006, 0.3)
    assert_close(after.T_reference_camera, inverse(path(4)[1]) @ path(4)[3], 0.004, 0.2)


def elsewhere(seq: int) -> RgbdFrame:
    """The same corner from where nothing of the other views is seen."""
    away = rigid_transform(rotation_from_vector([0.0, 0.7, 0.0]), [1.6, -0.3, 0.2])
    return view_of_a_corner(away @ path(seq + 1)[seq], seq)


def test_after_too_many_failures_tracking_starts_afresh(views: list[RgbdFrame]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=2))
    before = follow(odometry, views[:2])[1]
    lost = follow(odometry, [BLACK, elsewhere(0), elsewhere(1), elsewhere(2)])
    assert [e.ok for e in lost] == [False, False, True, True]
    assert [e.restarted for e in lost] == [False, False, True, False]
    assert np.array_equal(lost[2].T_world_camera, before.T_world_camera)
    step = inverse(lost[2].T_world_camera) @ lost[3].T_world_camera
    assert_close(step, inverse(path(3)[1]) @ path(3)[2], 0.004, 0.2)


def test_without_anything_to_see_it_does_not_start_afresh(views: list[RgbdFrame]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=2))
    follow(odometry, views[:1])
    lost = follow(odometry, [BLACK] * 5)
    assert not any(e.ok or e.restarted for e in lost)
    # The last good view was never given up: tracking goes on from it.
    found = odometry.estimate(views[1])
    assert found.ok
    assert not found.restarted
    assert_close(found.T_world_camera, path(2)[1], 0.004, 0.2)


def test_a_failure_in_between_does_not_count_towards_the_next(views: list[RgbdFrame]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=1))
    estimates = follow(odometry, [views[0], BLACK, views[1], elsewhere(0), views[2]])
    assert [e.ok for e in estimates] == [True, False, True, False, True]
    assert not any(e.restarted for e in estimates)


def test_frames_without_depth_are_an_answer(views: list[RgbdFrame]) -> None:
    no_depth = RgbdFrame(
        0, 0.0, 0.0, views[1].colour_bgr, np.zeros(SHAPE, np.uint16), 5000.0, CAMERA
    )
    _, failed = follow(SurfOdometry(), [views[0], no_depth])
    assert not failed.ok
    assert not SurfOdometry().estimate(no_depth).ok


def test_standing_still_is_no_motion(views: list[RgbdFrame]) -> None:
    estimates = follow(SurfOdometry(), [views[0]] * 4)
    assert all(e.ok for e in estimates)
    np.testing.assert_allclose(estimates[-1].T_world_camera, np.eye(4), atol=1e-12)


def test_upright_features_serve_as_well(views: list[RgbdFrame]) -> None:
    estimates = follow(SurfOdometry(SurfExtractor(500, upright=True)), views)
    assert all(e.ok for e in estimates)
    assert_close(estimates[-1].T_world_camera, path(6)[5], 0.012, 0.6)


class StageNames:
    def __init__(self) -> None:
        self.names: list[str] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.names.append(name)
        yield


def test_every_stage_is_timed_in_the_papers_order(views: list[RgbdFrame]) -> None:
    stopwatch = StageNames()
    odometry = SurfOdometry(stopwatch=stopwatch)
    follow(odometry, views[:2])
    assert stopwatch.names == ["surf", "points", "surf", "points", "match", "ransac", "svd"]


@settings(FIRST_CALL_COMPILES, max_examples=25)
@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 5)), min_size=2, max_size=4))
def test_no_frame_is_an_error_and_every_pose_is_rigid(kinds: list[tuple[int, int]]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=1))
    for seed, kind in kinds:
        estimate = odometry.estimate(garbage(seed, kind))
        assert is_rigid(estimate.T_world_camera)
        assert is_rigid(estimate.T_reference_camera)
        assert np.all(np.isfinite(estimate.covariance))
        assert estimate.ok == (estimate.reason == "")


def garbage(seed: int, kind: int) -> RgbdFrame:
    """Noise, stripes, dots on a line or nothing, with depth that is noise, a plane or none."""
    random = np.random.default_rng(seed)
    grey = np.full(SHAPE, seed % 256, np.uint8)
    if kind in (0, 1):
        grey = random.integers(0, 256, SHAPE, dtype=np.uint8)
    elif kind == 2:
        grey[:, ::9] = 255 - seed % 256
    elif kind == 3:
        grey[118:124, 30:300:12] = 255 - seed % 256
    depth_m = random.uniform(0.0, 5.0, SHAPE) if kind == 0 else np.full(SHAPE, seed % 3 * 0.9)
    return frame_of(grey, depth_m)


def recorded(folder: Path, frames: int) -> list[Estimate]:
    with TumCamera(folder, None, Pace.LOCKSTEP) as camera:
        odometry = SurfOdometry()
        return [odometry.estimate(frame) for frame in islice(all_frames(camera), frames)]


def all_frames(camera: TumCamera) -> Iterator[RgbdFrame]:
    while True:
        try:
            yield camera.read(10.0)
        except EndOfStream:
            return


@pytest.mark.parametrize(
    ("name", "frames"),
    [("freiburg1_xyz_head", 10), ("freiburg1_desk_piece", 9), ("redkitchen", 100)],
)
def test_a_real_kinect_is_followed_through_every_frame(
    recordings: Path, name: str, frames: int
) -> None:
    estimates = recorded(recordings / name, frames)
    assert len(estimates) == frames
    assert [e.reason for e in estimates if not e.ok] == []
    assert min(e.inliers for e in estimates[1:]) > 50
