import numpy as np
import pytest

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, rigid_transform
from drivers.synthetic.config import ColorSensorModel, SyntheticConfig
from drivers.synthetic.renderer import pixel_rays
from drivers.synthetic.sensors import expose, gain_at, motion_blur, vignetting_map

CAMERA = PinholeCamera(128, 96, 100.0, 100.0, 63.5, 47.5)
RAYS = pixel_rays(CAMERA, np.zeros(5))
EVEN = np.ones((96, 128), dtype=np.float32)
ROOM = np.zeros((96, 128), dtype=np.int64)
CLEAN = SyntheticConfig.ideal().color


def blurred_edge(shift_m: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """A black-white edge 2 m away; the camera moves by `shift_m` while the shutter is open."""
    image = np.zeros((96, 128, 3), dtype=np.float32)
    image[:, 64:] = 200.0
    opening, closing = slide(shift_m / 2), slide(-shift_m / 2)
    return motion_blur(image, RAYS, 2 * EVEN, ROOM, opening[None], closing[None], CAMERA.fx)


def slide(shift_m: float) -> Array:
    return np.repeat(rigid_transform(np.eye(3), (shift_m, 0, 0))[None], 96, axis=0)


def test_a_still_camera_does_not_blur() -> None:
    edge = blurred_edge(0.0)
    assert set(np.unique(edge)) == {0.0, 200.0}


def test_an_edge_is_smeared_as_far_as_the_image_moves() -> None:
    """0.12 m at 2 m and 100 px focal length: 6 pixels."""
    row = blurred_edge(0.12)[48, :, 0]
    smeared = np.flatnonzero((row > 1) & (row < 199))
    assert 5 <= len(smeared) <= 7
    assert np.all(np.diff(row) >= -1e-3)
    assert row.sum() == pytest.approx(64 * 200.0, rel=0.01)


def test_noise_has_the_configured_power() -> None:
    gray = np.full((96, 128, 3), 128.0, dtype=np.float32)
    eye = ColorSensorModel(noise_sigma=3.0, softness_px=0.0)
    picture = expose(gray, 1.0, EVEN, eye, np.random.default_rng(0))
    assert np.std(picture) == pytest.approx(3.0, rel=0.05)
    assert np.mean(picture) == pytest.approx(128.0, abs=0.1)


def test_gain_and_vignette_scale_the_picture_and_never_wrap() -> None:
    bright = np.full((96, 128, 3), 200.0, dtype=np.float32)
    picture = expose(bright, 1.5, EVEN, CLEAN, np.random.default_rng(0))
    assert np.all(picture == 255)
    kept = vignetting_map(CAMERA, 0.2)
    assert kept[48, 64] > 0.999
    assert kept[0, 0] == pytest.approx(0.8, abs=0.01)


def test_exposure_hunts_and_comes_back_by_the_end_of_a_loop() -> None:
    eye = ColorSensorModel(gain_drift=0.2)
    gains = [gain_at(eye, t, 20.0) for t in np.linspace(0.0, 20.0, 200)]
    assert max(gains) - min(gains) > 0.2
    assert 0.8 <= min(gains) <= max(gains) <= 1.2
    assert gains[0] == pytest.approx(gains[-1])
    assert gain_at(CLEAN, 3.0, 20.0) == 1.0
