from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.core.geometry import inverse
from tests.vo_service.odometry.direct import rolling_shutter_views
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK, keep_depth_grid
from tests.vo_service.odometry.hand_held_sequence import BLACK, assert_close
from tests.vo_service.odometry.synthetic_views import (
    add_depth_noise,
    make_frame,
    make_textured_image,
    render_corner,
)
from tests.vo_service.slam.corner_keyframes import (
    BESIDE,
    ELSEWHERE,
    HERE,
    ZERO_VELOCITY,
    make_pose,
    make_query,
)
from vo_service.odometry.direct import aligner
from vo_service.odometry.direct.parameters import DEPTH_NOISE_PER_M
from vo_service.slam.keyframe_database import LOST_VELOCITY_SIGMA, MapKeyframe
from vo_service.slam.place_recognizer import MatchCandidate, PlaceRecognizer


def test_a_keyframe_is_recognized_from_a_nearby_pose(
    recognizer: PlaceRecognizer, here: MapKeyframe
) -> None:
    found = recognizer.recognize(make_query(recognizer, BESIDE), [here])
    assert found is not None
    assert found.keyframe_number == here.number
    assert found.inliers >= 15
    assert_close(found.T_keyframe_camera, inverse(HERE) @ BESIDE, meters=2e-3, degrees=0.1)


def test_the_covariance_covers_the_error(recognizer: PlaceRecognizer, here: MapKeyframe) -> None:
    found = recognizer.recognize(make_query(recognizer, BESIDE), [here])
    assert found is not None
    error_m = np.abs((inverse(BESIDE) @ HERE @ found.T_keyframe_camera)[:3, 3])
    sigma_m = np.sqrt(np.diag(found.covariance)[:3])
    assert np.all(error_m < 4.0 * sigma_m)
    assert np.all(sigma_m < 0.01)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_a_keyframe_is_recognized_after_a_loss(
    recognizer: PlaceRecognizer, here: MapKeyframe
) -> None:
    view = recognizer.create_query(render_corner(BESIDE), ZERO_VELOCITY, LOST_VELOCITY_SIGMA)
    found = recognizer.recognize(view, [here])
    assert found is not None
    assert_close(found.T_keyframe_camera, BESIDE, meters=3e-3, degrees=0.1)


def test_a_keyframe_of_a_noisy_sensor_is_recognized(recognizer: PlaceRecognizer) -> None:
    """Stereo: neighbors share errors, three times those of a Kinect."""
    here, beside = (
        recognizer.create_query(add_depth_noise(render_corner(T), 6e-3, 2.5, k), ZERO_VELOCITY)
        for k, T in enumerate((HERE, BESIDE))
    )
    assert here.view.images.depth_noise > 2.0 * DEPTH_NOISE_PER_M
    found = recognizer.recognize(beside, [recognizer.create_keyframe(here, 0, 0, HERE)])
    assert found is not None
    assert_close(found.T_keyframe_camera, BESIDE, meters=0.02, degrees=0.5)


def test_a_keyframe_with_a_sparse_grid_of_depth_is_recognized(recognizer: PlaceRecognizer) -> None:
    here, beside = (
        recognizer.create_query(keep_depth_grid(render_corner(T), 3.0), ZERO_VELOCITY)
        for T in (HERE, BESIDE)
    )
    found = recognizer.recognize(beside, [recognizer.create_keyframe(here, 0, 0, HERE)])
    assert found is not None
    assert_close(found.T_keyframe_camera, BESIDE, meters=0.01, degrees=0.3)


def test_of_several_keyframes_the_one_in_view_is_recognized(
    recognizer: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    view = make_query(recognizer, ELSEWHERE @ BESIDE)
    found = recognizer.recognize(view, [here, elsewhere])
    assert found is not None
    assert found.keyframe_number == elsewhere.number


def test_an_unseen_place_is_not_recognized(
    recognizer: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    poster = make_frame(make_textured_image(240, 320, seed=9), np.full((240, 320), 1.7))
    for frame in (poster, BLACK):
        view = recognizer.create_query(frame, ZERO_VELOCITY)
        assert recognizer.recognize(view, [here, elsewhere]) is None
    assert recognizer.recognize(make_query(recognizer, ELSEWHERE), [here]) is None
    assert recognizer.recognize(make_query(recognizer, HERE), []) is None


def test_two_keyframes_that_look_the_same_are_ambiguous(
    recognizer: PlaceRecognizer, here: MapKeyframe
) -> None:
    view, duplicate = make_query(recognizer, BESIDE), replace(here, number=5)
    apart = {0: HERE, 5: make_pose((3.0, 0.0, 0.0))}
    turned = {0: HERE, 5: make_pose((0.1, 0.0, 0.0), (0.0, 40.0, 0.0))}
    together = {0: HERE, 5: make_pose((0.1, 0.0, 0.0))}
    unconnected = {0: HERE}
    assert recognizer.recognize(view, [here, duplicate], apart) is None
    assert recognizer.recognize(view, [here, duplicate], turned) is None
    assert recognizer.recognize(view, [here, duplicate], together) is not None
    assert recognizer.recognize(view, [here, duplicate], unconnected) is not None
    assert recognizer.recognize(view, [here], apart) is not None


def test_the_same_image_at_another_distance_is_not_recognized(
    recognizer: PlaceRecognizer, here: MapKeyframe
) -> None:
    """Features alone do not distinguish a photograph of the corner from the corner."""
    frame = render_corner(HERE)
    photograph = make_frame(frame.gray, np.full(frame.gray.shape, 1.2))
    assert recognizer.recognize(recognizer.create_query(photograph, ZERO_VELOCITY), [here]) is None


@pytest.mark.parametrize("T_place_camera", [ELSEWHERE, make_pose((0.3, 0.0, 0.0))])
def test_a_wrong_match_is_not_verified(
    recognizer: PlaceRecognizer, here: MapKeyframe, T_place_camera: np.ndarray
) -> None:
    candidate = MatchCandidate(here, T_place_camera, inliers=100)
    assert recognizer.verify(make_query(recognizer, BESIDE), candidate) is None


@pytest.mark.parametrize(
    ("off", "is_accepted"),
    [
        (make_pose((0.02, 0.0, 0.0)), True),
        (make_pose((0.06, 0.0, 0.0)), False),
        (make_pose((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)), False),
    ],
)
def test_features_and_alignment_must_agree(
    recognizer: PlaceRecognizer, here: MapKeyframe, off: np.ndarray, is_accepted: bool
) -> None:
    """The alignment converges to the truth from each of these."""
    found = recognizer.verify(
        make_query(recognizer, BESIDE), MatchCandidate(here, BESIDE @ off, 100)
    )
    assert (found is not None) is is_accepted


@pytest.mark.parametrize("check", ["rejection_reason", "occlusion_reason"])
def test_an_alignment_rejected_by_the_odometry_is_not_recognized(
    recognizer: PlaceRecognizer, here: MapKeyframe, monkeypatch: pytest.MonkeyPatch, check: str
) -> None:
    view = make_query(recognizer, BESIDE)
    monkeypatch.setattr(aligner, check, lambda found: "too little texture")
    assert recognizer.recognize(view, [here]) is None


@pytest.mark.parametrize(("rejection", "sigma_m"), [("", 0.01), ("rows are unsure", 1e-3)])
def test_a_large_covariance_is_not_recognized(
    recognizer: PlaceRecognizer,
    here: MapKeyframe,
    monkeypatch: pytest.MonkeyPatch,
    rejection: str,
    sigma_m: float,
) -> None:
    view = make_query(recognizer, BESIDE)
    unsure = SimpleNamespace(rejection_reason=rejection, covariance=np.eye(6) * sigma_m**2)
    monkeypatch.setattr(aligner, "estimate_uncertainty", lambda *given: unsure)
    assert recognizer.recognize(view, [here]) is None


@pytest.mark.parametrize(("nearer_m", "is_recognised"), [(0.8, True), (1.2, False)])
def test_a_third_of_a_keyframe_must_be_in_view(
    recognizer: PlaceRecognizer, here: MapKeyframe, nearer_m: float, is_recognised: bool
) -> None:
    found = recognizer.recognize(make_query(recognizer, make_pose((0.0, 0.0, nearer_m))), [here])
    assert (found is not None) is is_recognised


def test_a_rolling_shutter_view_is_recognized(
    recognizer: PlaceRecognizer,
) -> None:
    standing = recognizer.create_query(rolling_shutter_views.render_view(), ZERO_VELOCITY)
    keyframe, T = recognizer.create_keyframe(standing, 0, 0, HERE), BRISK.pose_at(0.1)
    moving = recognizer.create_query(
        rolling_shutter_views.render_view(BRISK, 0.1, readout_s=0.03), BRISK.velocity
    )
    found = recognizer.verify(moving, MatchCandidate(keyframe, T, inliers=50))
    assert found is not None
    assert_close(found.T_keyframe_camera, T, meters=3e-4, degrees=0.01)


def test_a_darker_view_is_recognized(recognizer: PlaceRecognizer, here: MapKeyframe) -> None:
    frame = render_corner(BESIDE)
    dusk = replace(frame, color_bgr=(0.75 * frame.color_bgr).astype(np.uint8))
    found = recognizer.recognize(recognizer.create_query(dusk, ZERO_VELOCITY), [here])
    assert found is not None
    assert_close(found.T_keyframe_camera, BESIDE, meters=3e-3, degrees=0.1)
