from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.core.geometry import inverse
from tests.vo_service.odometry.direct import rolling_shutter_views
from tests.vo_service.odometry.direct.rolling_shutter_views import BRISK
from tests.vo_service.odometry.hand_held_sequence import BLACK, assert_close
from tests.vo_service.odometry.synthetic_views import make_frame, make_textured_image, render_corner
from tests.vo_service.slam.place_recognition.corner_keyframes import (
    BESIDE,
    ELSEWHERE,
    HERE,
    ZERO_VELOCITY,
    make_pose,
    make_query,
)
from vo_service.slam.place_recognition import place_recognizer
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.place_recognizer import MatchCandidate, PlaceRecognizer
from vo_service.slam.place_recognition.query_frame import LOST_VELOCITY_SIGMA


def test_a_place_is_known_again_from_beside_it(
    recogniser: PlaceRecognizer, here: MapKeyframe
) -> None:
    found = recogniser.recognize(make_query(recogniser, BESIDE), [here])
    assert found is not None
    assert found.keyframe_number == here.number
    assert found.inliers >= 15
    assert_close(found.T_keyframe_camera, inverse(HERE) @ BESIDE, metres=2e-3, degrees=0.1)


def test_the_covariance_holds_the_error(recogniser: PlaceRecognizer, here: MapKeyframe) -> None:
    found = recogniser.recognize(make_query(recogniser, BESIDE), [here])
    assert found is not None
    error_m = np.abs((inverse(BESIDE) @ HERE @ found.T_keyframe_camera)[:3, 3])
    sigma_m = np.sqrt(np.diag(found.covariance)[:3])
    assert np.all(error_m < 4.0 * sigma_m)
    assert np.all(sigma_m < 0.01)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_it_is_known_again_after_a_loss(recogniser: PlaceRecognizer, here: MapKeyframe) -> None:
    view = recogniser.create_query(render_corner(BESIDE), ZERO_VELOCITY, LOST_VELOCITY_SIGMA)
    found = recogniser.recognize(view, [here])
    assert found is not None
    assert_close(found.T_keyframe_camera, BESIDE, metres=3e-3, degrees=0.1)


def test_of_several_places_the_one_in_view_is_recognised(
    recogniser: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    view = make_query(recogniser, ELSEWHERE @ BESIDE)
    found = recogniser.recognize(view, [here, elsewhere])
    assert found is not None
    assert found.keyframe_number == elsewhere.number


def test_what_was_never_seen_is_not_recognised(
    recogniser: PlaceRecognizer, here: MapKeyframe, elsewhere: MapKeyframe
) -> None:
    poster = make_frame(make_textured_image(240, 320, seed=9), np.full((240, 320), 1.7))
    for frame in (poster, BLACK):
        view = recogniser.create_query(frame, ZERO_VELOCITY)
        assert recogniser.recognize(view, [here, elsewhere]) is None
    assert recogniser.recognize(make_query(recogniser, ELSEWHERE), [here]) is None


def test_two_places_that_look_the_same_are_no_place(
    recogniser: PlaceRecognizer, here: MapKeyframe
) -> None:
    view, twin = make_query(recogniser, BESIDE), replace(here, number=5)
    apart = {0: HERE, 5: make_pose((3.0, 0.0, 0.0))}
    turned = {0: HERE, 5: make_pose((0.1, 0.0, 0.0), (0.0, 40.0, 0.0))}
    together = {0: HERE, 5: make_pose((0.1, 0.0, 0.0))}
    assert recogniser.recognize(view, [here, twin], apart) is None
    assert recogniser.recognize(view, [here, twin], turned) is None
    assert recogniser.recognize(view, [here, twin], together) is not None
    assert recogniser.recognize(view, [here], apart) is not None


def test_a_rival_that_nothing_joins_to_the_map_is_none(
    recogniser: PlaceRecognizer, here: MapKeyframe
) -> None:
    view, twin = make_query(recogniser, BESIDE), replace(here, number=5)
    assert recogniser.recognize(view, [here, twin], {0: HERE}) is not None


def test_without_places_nothing_is_recognised(recogniser: PlaceRecognizer) -> None:
    assert recogniser.recognize(make_query(recogniser, HERE), []) is None


def test_the_same_picture_at_another_distance_is_another_thing(
    recogniser: PlaceRecognizer, here: MapKeyframe
) -> None:
    """Features alone could not tell a photograph of the corner from the corner."""
    frame = render_corner(HERE)
    photograph = make_frame(frame.gray, np.full(frame.gray.shape, 1.2))
    assert recogniser.recognize(recogniser.create_query(photograph, ZERO_VELOCITY), [here]) is None


@pytest.mark.parametrize("T_place_camera", [ELSEWHERE, make_pose((0.3, 0.0, 0.0))])
def test_a_wrong_sighting_is_not_confirmed(
    recogniser: PlaceRecognizer, here: MapKeyframe, T_place_camera: np.ndarray
) -> None:
    sighting = MatchCandidate(here, T_place_camera, inliers=100)
    assert recogniser.verify(make_query(recogniser, BESIDE), sighting) is None


@pytest.mark.parametrize(
    ("off", "is_believed"),
    [
        (make_pose((0.02, 0.0, 0.0)), True),
        (make_pose((0.06, 0.0, 0.0)), False),
        (make_pose((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)), False),
    ],
)
def test_features_and_alignment_have_to_agree(
    recogniser: PlaceRecognizer, here: MapKeyframe, off: np.ndarray, is_believed: bool
) -> None:
    """The alignment would come to the truth from each of these."""
    found = recogniser.verify(
        make_query(recogniser, BESIDE), MatchCandidate(here, BESIDE @ off, 100)
    )
    assert (found is not None) is is_believed


@pytest.mark.parametrize("check", ["rejection_reason", "occlusion_reason"])
def test_what_the_odometry_would_doubt_is_not_recognised(
    recogniser: PlaceRecognizer, here: MapKeyframe, monkeypatch: pytest.MonkeyPatch, check: str
) -> None:
    view = make_query(recogniser, BESIDE)
    monkeypatch.setattr(place_recognizer, check, lambda found: "too little texture")
    assert recogniser.recognize(view, [here]) is None


@pytest.mark.parametrize(("rejection", "sigma_m"), [("", 0.01), ("rows are unsure", 1e-3)])
def test_what_is_not_known_well_enough_is_not_recognised(
    recogniser: PlaceRecognizer,
    here: MapKeyframe,
    monkeypatch: pytest.MonkeyPatch,
    rejection: str,
    sigma_m: float,
) -> None:
    view = make_query(recogniser, BESIDE)
    unsure = SimpleNamespace(rejection_reason=rejection, covariance=np.eye(6) * sigma_m**2)
    monkeypatch.setattr(place_recognizer, "estimate_uncertainty", lambda *given: unsure)
    assert recogniser.recognize(view, [here]) is None


@pytest.mark.parametrize(("nearer_m", "is_recognised"), [(0.8, True), (1.2, False)])
def test_of_a_place_a_third_has_to_be_in_view(
    recogniser: PlaceRecognizer, here: MapKeyframe, nearer_m: float, is_recognised: bool
) -> None:
    found = recogniser.recognize(make_query(recogniser, make_pose((0.0, 0.0, nearer_m))), [here])
    assert (found is not None) is is_recognised


def test_features_that_agree_by_chance_are_no_sighting(
    recogniser: PlaceRecognizer, here: MapKeyframe
) -> None:
    poster = make_frame(make_textured_image(240, 320, seed=9), np.full((240, 320), 1.7))
    assert (
        list(recogniser.find_candidates(recogniser.create_query(poster, ZERO_VELOCITY), [here]))
        == []
    )


def test_a_view_whose_rows_were_taken_on_the_move_is_known_again(
    recogniser: PlaceRecognizer,
) -> None:
    standing = recogniser.create_query(rolling_shutter_views.render_view(), ZERO_VELOCITY)
    place, T = recogniser.create_keyframe(standing, 0, 0, HERE), BRISK.pose_at(0.1)
    moving = recogniser.create_query(
        rolling_shutter_views.render_view(BRISK, 0.1, readout_s=0.03), BRISK.velocity
    )
    found = recogniser.verify(moving, MatchCandidate(place, T, inliers=50))
    assert found is not None
    assert_close(found.T_keyframe_camera, T, metres=3e-4, degrees=0.01)


def test_darker_light_is_no_other_place(recogniser: PlaceRecognizer, here: MapKeyframe) -> None:
    frame = render_corner(BESIDE)
    dusk = replace(frame, color_bgr=(0.75 * frame.color_bgr).astype(np.uint8))
    found = recogniser.recognize(recogniser.create_query(dusk, ZERO_VELOCITY), [here])
    assert found is not None
    assert_close(found.T_keyframe_camera, BESIDE, metres=3e-3, degrees=0.1)


def test_the_same_view_gives_the_same_bits(here: MapKeyframe) -> None:
    first, second = (
        recogniser.recognize(make_query(recogniser, BESIDE), [here])
        for recogniser in (PlaceRecognizer(), PlaceRecognizer())
    )
    assert first is not None
    assert second is not None
    assert first.T_keyframe_camera.tobytes() == second.T_keyframe_camera.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()
