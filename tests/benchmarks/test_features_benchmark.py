"""The scores of the feature benchmark."""

import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks import features
from benchmarks.__main__ import main
from benchmarks.features import (
    METHODS,
    FeatureScore,
    Gray,
    ImageTransform,
    all_transforms,
    is_inside,
    make_perspective_tilt,
    make_rotation,
    measure_cost,
    scale_at,
    score_features,
    transform_points,
)
from drivers.core.geometry import Array
from vo_service.odometry.features.extractor import Features
from vo_service.tools.compare.baselines.frame_to_frame import MATCH_RATIO

SIZE = (320, 240)
TILT = make_perspective_tilt(SIZE, 0.1, 0.0, 0.0, 0.15)


def random_features(count: int = 50) -> Features:
    """Features spread over the image, with different descriptors."""
    rng, unused = np.random.default_rng(0), np.empty(0, np.float32)
    return Features(
        position_px=rng.uniform((20, 20), (300, 220), (count, 2)).astype(np.float32),
        scale_px=rng.uniform(2.0, 10.0, count).astype(np.float32),
        direction=unused,
        response=unused,
        sign=unused,
        descriptor=rng.normal(0, 1, (count, 32)).astype(np.float32),
    )


def moved(features: Features, by_px: float = 0.0, scale: float = 1.0) -> Features:
    position_px = features.position_px + np.array([by_px, 0.0], np.float32)
    return replace(
        features, position_px=position_px, scale_px=np.float32(scale) * features.scale_px
    )


def transformed(features: Features, H: Array) -> Features:
    position_px = transform_points(H, features.position_px.astype(np.float64))
    scale_px = features.scale_px * scale_at(H, features.position_px.astype(np.float64))
    return replace(
        features,
        position_px=position_px.astype(np.float32),
        scale_px=scale_px.astype(np.float32),
    )


def score(original: Features, changed: Features, H: Array) -> FeatureScore:
    return score_features(original, changed, MATCH_RATIO, H, SIZE)


def texture() -> Gray:
    noise = np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.asarray(cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX), np.uint8)  # type: ignore[call-overload]


@pytest.mark.parametrize(
    "change", [c for c in all_transforms(SIZE) if c.group not in ("light", "noise")]
)
def test_a_transform_moves_a_spot_by_its_homography(change: ImageTransform) -> None:
    image = np.zeros((240, 320), np.uint8)
    cv2.circle(image, (150, 130), 4, 255, -1)
    moments = cv2.moments(change.apply(image))
    middle_px = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
    expected_px = transform_points(change.H, np.array([[150.0, 130.0]]))[0]
    assert middle_px == pytest.approx(expected_px, abs=0.3)


def test_every_transform_is_repeatable_and_changes_the_image() -> None:
    image = texture()
    changes = all_transforms(SIZE)
    assert len(changes) == 34
    for change in changes:
        assert np.array_equal(change.apply(image), change.apply(image))
        assert not np.array_equal(change.apply(image), image)


def test_zoom_is_the_ratio_of_distances() -> None:
    points = np.array([[30.0, 40.0], [250.0, 200.0]])
    right, down = (transform_points(TILT, points + step) for step in ([1e-4, 0], [0, 1e-4]))
    sides = np.stack([right, down], axis=1) - transform_points(TILT, points)[:, None]
    assert scale_at(TILT, points) == pytest.approx(np.sqrt(np.linalg.det(sides)) * 1e4, rel=1e-3)
    assert scale_at(make_rotation(SIZE, 30.0, 1.4), points) == pytest.approx([1.4, 1.4])


def test_features_that_follow_the_homography_are_all_repeated_and_correct() -> None:
    original = random_features()
    result = score(original, transformed(original, TILT), TILT)
    assert result.max_repeatable == result.repeated == result.matches == result.correct == 50
    assert np.allclose(result.errors_px, 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("by_px", "scale", "repeated", "correct"),
    [
        (1.9, 1.0, True, True),
        (2.6, 1.0, False, True),
        (3.1, 1.0, False, False),
        (0.0, 1.4, True, True),
        (0.0, 1.6, False, True),
        (0.0, 0.6, False, True),
    ],
)
def test_features_elsewhere_or_at_another_scale_do_not_count(
    by_px: float, scale: float, repeated: bool, correct: bool
) -> None:
    original = random_features(count=8)  # far from one another
    result = score(original, moved(original, by_px, scale), np.eye(3))
    assert (result.repeated, result.correct) == (8 * repeated, 8 * correct)
    assert result.matches == 8


def test_distances_are_in_pixels_of_the_original() -> None:
    original = random_features(count=8)
    H = make_rotation(SIZE, 0.0, 0.5)
    seen = transformed(original, H)
    assert score(original, moved(seen, by_px=0.9), H).repeated == 8
    assert score(original, moved(seen, by_px=1.1), H).repeated == 0


def test_descriptors_of_another_feature_are_wrong_matches() -> None:
    original = random_features()
    swapped = replace(original, descriptor=original.descriptor[::-1].copy())
    result = score(original, swapped, np.eye(3))
    assert (result.repeated, result.matches, result.correct) == (50, 50, 0)


def test_features_outside_the_other_image_are_not_possible() -> None:
    original = random_features()
    H = make_rotation(SIZE, 0.0, 2.0)
    in_view = is_inside(transformed(original, H).position_px.astype(np.float64), SIZE)
    result = score(original, original, H)
    assert 0 < in_view.sum() < 50
    assert result.max_repeatable == in_view.sum()


def test_an_image_without_features_scores_nothing() -> None:
    extractor, _ = METHODS["SIFT"]
    empty = extractor.extract(np.zeros((240, 320), np.uint8))
    result = score(random_features(), empty, np.eye(3))
    assert (result.max_repeatable, result.repeated, result.matches, result.correct) == (0, 0, 0, 0)


def benchmark(*arguments: object) -> int:
    return main(["features", *map(str, arguments)])


def test_the_cost_is_the_processor_time_of_one_round() -> None:
    class SlowExtractor:
        count = 7

        def extract(self, gray: Gray) -> Features:
            end_s = time.process_time() + 0.05  # far longer than a tick of a coarse clock
            while time.process_time() < end_s:
                pass
            return random_features(self.count)

    cost_ms, count = measure_cost(SlowExtractor(), texture())
    assert cost_ms >= 50.0
    assert count == 7


def test_pictures_and_folders_are_measured_by_all_three(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    picture = tmp_path / "texture.png"
    cv2.imwrite(str(picture), texture()[:120, :160])
    assert benchmark(picture) == 0
    images, heads, *rows = capsys.readouterr().out.splitlines()
    assert images == "1 images, 34 transforms of each"
    assert [row.split()[0] for row in rows] == ["SURF", "SIFT", "ORB"]
    for row in rows:
        cells = dict(zip(heads.split(), row.split()[1:], strict=False))
        assert 0.2 < float(cells["repeat."]) <= 1
        assert 0.5 < float(cells["precision"]) <= 1


def test_a_file_that_is_not_an_image_is_a_clear_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("not an image")
    assert benchmark(tmp_path / "notes.txt") == 2
    assert capsys.readouterr().err.endswith("notes.txt: not a readable image\n")


def test_frames_of_a_recording_are_evenly_spread(recording: Path) -> None:
    assert [file.name for file in features.sample_images(recording, 3)] == [
        "0.000000.png", "0.200000.png", "0.366667.png",
    ]  # fmt: skip
