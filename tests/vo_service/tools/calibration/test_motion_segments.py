"""Which pieces of a film are kept for the timing: those in which the camera was shaken."""

from collections.abc import Callable

import numpy as np
import pytest

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.errors import UserFacingError
from tests.vo_service.odometry.synthetic_views import make_frame, make_textured_image
from vo_service.tools.calibration.motion_segments import (
    MAX_SEGMENTS,
    SEGMENT_FRAMES,
    FastestSegments,
)
from vo_service.tools.calibration.timing import check_motion

CAMERA = PinholeCamera(160, 120, 145.0, 145.0, 79.5, 59.5)
SCENE = make_textured_image(120, 400)


def film(frames: int, column_at: Callable[[int], float]) -> list[RgbdFrame]:
    """A view that slides over a picture."""
    views = [SCENE[:, round(column_at(n)) :][:, :160] for n in range(frames)]
    return [make_frame(v, np.ones(v.shape), n, CAMERA) for n, v in enumerate(views)]


def pieces_of(frames: list[RgbdFrame]) -> FastestSegments:
    pieces = FastestSegments()
    for frame in frames:
        pieces.process(frame)
    return pieces


def shaken(n: int) -> float:
    return float(100 + 20 * np.sin(n / 3))


def test_the_briskest_pieces_are_kept_the_briskest_first() -> None:
    strength = [0.0, 3.0, 1.0, 2.0]
    frames = film(
        4 * SEGMENT_FRAMES, lambda n: 100 + strength[n // SEGMENT_FRAMES] * (shaken(n) - 100)
    )
    kept = pieces_of(frames).segments
    first = [piece.frames[0].seq // SEGMENT_FRAMES for piece in kept]
    assert first == [1, 3, 2, 0]
    assert (
        kept[0].speed_sigma_rad_s
        > kept[1].speed_sigma_rad_s
        > kept[2].speed_sigma_rad_s
        > kept[3].speed_sigma_rad_s
    )


def test_no_more_pieces_are_held_than_are_used() -> None:
    pieces = pieces_of(film(SEGMENT_FRAMES, shaken) * (MAX_SEGMENTS + 3))
    assert (len(pieces.segments), pieces.frame_count) == (
        MAX_SEGMENTS,
        SEGMENT_FRAMES * (MAX_SEGMENTS + 3),
    )


def test_the_shake_is_how_much_the_speed_of_the_image_changes() -> None:
    # 20 / 3 pixels a frame at most: 0.98 rad/s by the focal length, by the square root of two.
    assert pieces_of(film(SEGMENT_FRAMES, shaken)).speed_sigma_rad_s == pytest.approx(0.98, rel=0.1)
    evenly = pieces_of(film(SEGMENT_FRAMES, lambda n: 2 * n))
    assert evenly.speed_sigma_rad_s == pytest.approx(0.0, abs=0.03)


def test_a_gap_begins_a_new_piece() -> None:
    frames = film(2 * SEGMENT_FRAMES, shaken)
    assert [p.frames[0].seq for p in pieces_of(frames[:20] + frames[30:]).segments] == [30]


def test_a_short_film_and_a_still_one_are_refused_before_any_work() -> None:
    with pytest.raises(UserFacingError, match="too short: 3 stretches of 32 frames"):
        check_motion(pieces_of(film(SEGMENT_FRAMES, shaken) * 3).segments)
    with pytest.raises(UserFacingError, match=r"too slowly to tell .* by 0\.\d degrees a second"):
        check_motion(pieces_of(film(SEGMENT_FRAMES, lambda n: 100) * 5).segments)
