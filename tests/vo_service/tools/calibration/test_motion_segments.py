"""Selection of the fastest segments for the estimation of timing."""

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


def render_frames(frames: int, column_at: Callable[[int], float]) -> list[RgbdFrame]:
    """Render a view that slides over an image."""
    views = [SCENE[:, round(column_at(n)) :][:, :160] for n in range(frames)]
    return [make_frame(v, np.ones(v.shape), n, CAMERA) for n, v in enumerate(views)]


def collect_segments(frames: list[RgbdFrame]) -> FastestSegments:
    segments = FastestSegments()
    for frame in frames:
        segments.process(frame)
    return segments


def shaken_column(n: int) -> float:
    return float(100 + 20 * np.sin(n / 3))


def test_the_fastest_segments_come_first() -> None:
    amplitudes = [0.0, 3.0, 1.0, 2.0]
    frames = render_frames(
        4 * SEGMENT_FRAMES,
        lambda n: 100 + amplitudes[n // SEGMENT_FRAMES] * (shaken_column(n) - 100),
    )
    fastest = collect_segments(frames).segments
    order = [segment.frames[0].seq // SEGMENT_FRAMES for segment in fastest]
    assert order == [1, 3, 2, 0]
    assert (
        fastest[0].speed_sigma_rad_s
        > fastest[1].speed_sigma_rad_s
        > fastest[2].speed_sigma_rad_s
        > fastest[3].speed_sigma_rad_s
    )


def test_the_number_of_segments_is_limited() -> None:
    segments = collect_segments(render_frames(SEGMENT_FRAMES, shaken_column) * (MAX_SEGMENTS + 3))
    assert (len(segments.segments), segments.frame_count) == (
        MAX_SEGMENTS,
        SEGMENT_FRAMES * (MAX_SEGMENTS + 3),
    )


def test_the_speed_sigma_is_that_of_the_images_speed() -> None:
    # 20 / 3 pixels a frame at most: 0.98 rad/s by the focal length, by the square root of two.
    assert collect_segments(
        render_frames(SEGMENT_FRAMES, shaken_column)
    ).speed_sigma_rad_s == pytest.approx(0.98, rel=0.1)
    constant = collect_segments(render_frames(SEGMENT_FRAMES, lambda n: 2 * n))
    assert constant.speed_sigma_rad_s == pytest.approx(0.0, abs=0.03)


def test_a_gap_starts_a_new_segment() -> None:
    frames = render_frames(2 * SEGMENT_FRAMES, shaken_column)
    assert [p.frames[0].seq for p in collect_segments(frames[:20] + frames[30:]).segments] == [30]


def test_a_short_and_a_still_recording_are_rejected_at_once() -> None:
    with pytest.raises(UserFacingError, match="too short: 3 segments of 32 frames"):
        check_motion(collect_segments(render_frames(SEGMENT_FRAMES, shaken_column) * 3).segments)
    with pytest.raises(
        UserFacingError, match=r"too slowly to determine .* by 0\.\d degrees a second"
    ):
        check_motion(collect_segments(render_frames(SEGMENT_FRAMES, lambda n: 100) * 5).segments)
