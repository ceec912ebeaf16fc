from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.geometry import inverse
from tests.vo_service.mapping.places.corner_places import (
    BESIDE,
    ELSEWHERE,
    HERE,
    STANDING,
    pose,
    view_from,
)
from tests.vo_service.odometry.keyframe import rolling_views
from tests.vo_service.odometry.keyframe.rolling_views import BRISK
from tests.vo_service.odometry.synthetic_views import frame_of, textured_image, view_of_a_corner
from tests.vo_service.odometry.walk import BLACK, assert_close
from vo_service.mapping.places import recognition
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.recognition import Recogniser, Sighting
from vo_service.mapping.places.view import LOST


def test_a_place_is_known_again_from_beside_it(recogniser: Recogniser, here: Place) -> None:
    found = recogniser.recognise(view_from(recogniser, BESIDE), [here])
    assert found is not None
    assert found.number == here.number
    assert found.inliers >= 15
    assert_close(found.T_place_camera, inverse(HERE) @ BESIDE, metres=2e-3, degrees=0.1)


def test_the_covariance_holds_the_error(recogniser: Recogniser, here: Place) -> None:
    found = recogniser.recognise(view_from(recogniser, BESIDE), [here])
    assert found is not None
    error_m = np.abs((inverse(BESIDE) @ HERE @ found.T_place_camera)[:3, 3])
    sigma_m = np.sqrt(np.diag(found.covariance)[:3])
    assert np.all(error_m < 4.0 * sigma_m)
    assert np.all(sigma_m < 0.01)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


def test_it_is_known_again_after_a_loss(recogniser: Recogniser, here: Place) -> None:
    view = recogniser.view(view_of_a_corner(BESIDE), STANDING, LOST)
    found = recogniser.recognise(view, [here])
    assert found is not None
    assert_close(found.T_place_camera, BESIDE, metres=3e-3, degrees=0.1)


def test_of_several_places_the_one_in_view_is_recognised(
    recogniser: Recogniser, here: Place, elsewhere: Place
) -> None:
    view = view_from(recogniser, ELSEWHERE @ BESIDE)
    found = recogniser.recognise(view, [here, elsewhere])
    assert found is not None
    assert found.number == elsewhere.number


def test_what_was_never_seen_is_not_recognised(
    recogniser: Recogniser, here: Place, elsewhere: Place
) -> None:
    poster = frame_of(textured_image(240, 320, seed=9), np.full((240, 320), 1.7))
    for frame in (poster, BLACK):
        view = recogniser.view(frame, STANDING)
        assert recogniser.recognise(view, [here, elsewhere]) is None
    assert recogniser.recognise(view_from(recogniser, ELSEWHERE), [here]) is None


def test_two_places_that_look_the_same_are_no_place(recogniser: Recogniser, here: Place) -> None:
    view, twin = view_from(recogniser, BESIDE), replace(here, number=5)
    apart = {0: HERE, 5: pose((3.0, 0.0, 0.0))}
    turned = {0: HERE, 5: pose((0.1, 0.0, 0.0), (0.0, 40.0, 0.0))}
    together = {0: HERE, 5: pose((0.1, 0.0, 0.0))}
    assert recogniser.recognise(view, [here, twin], apart) is None
    assert recogniser.recognise(view, [here, twin], turned) is None
    assert recogniser.recognise(view, [here, twin], together) is not None
    assert recogniser.recognise(view, [here], apart) is not None


def test_a_rival_that_nothing_joins_to_the_map_is_none(recogniser: Recogniser, here: Place) -> None:
    view, twin = view_from(recogniser, BESIDE), replace(here, number=5)
    assert recogniser.recognise(view, [here, twin], {0: HERE}) is not None


def test_without_places_nothing_is_recognised(recogniser: Recogniser) -> None:
    assert recogniser.recognise(view_from(recogniser, HERE), []) is None


def test_the_same_picture_at_another_distance_is_another_thing(
    recogniser: Recogniser, here: Place
) -> None:
    """Features alone could not tell a photograph of the corner from the corner."""
    frame = view_of_a_corner(HERE)
    photograph = frame_of(frame.grey, np.full(frame.grey.shape, 1.2))
    assert recogniser.recognise(recogniser.view(photograph, STANDING), [here]) is None


@pytest.mark.parametrize("T_place_camera", [ELSEWHERE, pose((0.3, 0.0, 0.0))])
def test_a_wrong_sighting_is_not_confirmed(
    recogniser: Recogniser, here: Place, T_place_camera: np.ndarray
) -> None:
    sighting = Sighting(here, T_place_camera, inliers=100)
    assert recogniser.confirm(view_from(recogniser, BESIDE), sighting) is None


@pytest.mark.parametrize(
    ("off", "is_believed"),
    [
        (pose((0.02, 0.0, 0.0)), True),
        (pose((0.06, 0.0, 0.0)), False),
        (pose((0.0, 0.0, 0.0), (0.0, 0.0, 2.0)), False),
    ],
)
def test_features_and_alignment_have_to_agree(
    recogniser: Recogniser, here: Place, off: np.ndarray, is_believed: bool
) -> None:
    """The alignment would come to the truth from each of these."""
    found = recogniser.confirm(view_from(recogniser, BESIDE), Sighting(here, BESIDE @ off, 100))
    assert (found is not None) is is_believed


@pytest.mark.parametrize("check", ["doubt", "cover"])
def test_what_the_odometry_would_doubt_is_not_recognised(
    recogniser: Recogniser, here: Place, monkeypatch: pytest.MonkeyPatch, check: str
) -> None:
    view = view_from(recogniser, BESIDE)
    monkeypatch.setattr(recognition, check, lambda found: "too little texture")
    assert recogniser.recognise(view, [here]) is None


@pytest.mark.parametrize(("doubt", "sigma_m"), [("", 0.01), ("rows are unsure", 1e-3)])
def test_what_is_not_known_well_enough_is_not_recognised(
    recogniser: Recogniser,
    here: Place,
    monkeypatch: pytest.MonkeyPatch,
    doubt: str,
    sigma_m: float,
) -> None:
    view = view_from(recogniser, BESIDE)
    unsure = SimpleNamespace(doubt=doubt, covariance=np.eye(6) * sigma_m**2)
    monkeypatch.setattr(recognition, "certainty", lambda *given: unsure)
    assert recogniser.recognise(view, [here]) is None


@pytest.mark.parametrize(("nearer_m", "is_recognised"), [(0.8, True), (1.2, False)])
def test_of_a_place_a_third_has_to_be_in_view(
    recogniser: Recogniser, here: Place, nearer_m: float, is_recognised: bool
) -> None:
    found = recogniser.recognise(view_from(recogniser, pose((0.0, 0.0, nearer_m))), [here])
    assert (found is not None) is is_recognised


def test_features_that_agree_by_chance_are_no_sighting(recogniser: Recogniser, here: Place) -> None:
    poster = frame_of(textured_image(240, 320, seed=9), np.full((240, 320), 1.7))
    assert list(recogniser.sightings(recogniser.view(poster, STANDING), [here])) == []


def test_a_view_whose_rows_were_taken_on_the_move_is_known_again(recogniser: Recogniser) -> None:
    standing = recogniser.view(rolling_views.seen(), STANDING)
    place, T = recogniser.place(standing, 0, 0, HERE), BRISK.at(0.1)
    moving = recogniser.view(rolling_views.seen(BRISK, 0.1, readout_s=0.03), BRISK.velocity)
    found = recogniser.confirm(moving, Sighting(place, T, inliers=50))
    assert found is not None
    assert_close(found.T_place_camera, T, metres=3e-4, degrees=0.01)


def test_darker_light_is_no_other_place(recogniser: Recogniser, here: Place) -> None:
    frame = view_of_a_corner(BESIDE)
    dusk = replace(frame, colour_bgr=(0.75 * frame.colour_bgr).astype(np.uint8))
    found = recogniser.recognise(recogniser.view(dusk, STANDING), [here])
    assert found is not None
    assert_close(found.T_place_camera, BESIDE, metres=3e-3, degrees=0.1)


def test_the_same_view_gives_the_same_bits(here: Place) -> None:
    first, second = (
        recogniser.recognise(view_from(recogniser, BESIDE), [here])
        for recogniser in (Recogniser(), Recogniser())
    )
    assert first is not None
    assert second is not None
    assert first.T_place_camera.tobytes() == second.T_place_camera.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()
