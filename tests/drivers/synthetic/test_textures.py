import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.synthetic.prints import book_spines, page, parcel, picture, poster, screen
from drivers.synthetic.textures import (
    Face,
    TexturePainter,
    bricks,
    cabinet_doors,
    collage,
    fabric,
    flat_color,
    fractal_noise,
    plaster,
    wood,
)

RED, BLUE = (60.0, 60.0, 180.0), (180.0, 90.0, 60.0)
SKINS = {
    "plaster": plaster(RED),
    "fabric": fabric(RED, BLUE),
    "wood": wood(RED),
    "boards": wood(RED, 0.14),
    "bricks": bricks(RED),
    "doors": cabinet_doors(wood(BLUE), 3, 3),
    "picture": picture(),
    "page": page(),
    "poster": poster(),
    "spines": book_spines(),
    "parcel": parcel(),
    "screen": screen(),
    "collage": collage(plaster(BLUE), [(poster(), 0.4), (page(), 0.3)]),
}


def paint(texture: TexturePainter, seed: int = 0) -> NDArray[np.uint8]:
    image = texture(Face(np.random.default_rng(seed), 300, 420, 0.004))
    assert image.shape == (300, 420, 3)
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", SKINS)
def test_a_texture_is_repeatable_and_another_seed_paints_another(name: str) -> None:
    one, again, other = (paint(SKINS[name], seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.mean(cv2.absdiff(one, other)) > 1.0


@pytest.mark.parametrize("name", SKINS)
def test_no_two_places_of_a_texture_look_alike(name: str) -> None:
    """The best match of a patch elsewhere, by normalized correlation, is clearly worse."""
    image = paint(SKINS[name])
    rng = np.random.default_rng(0)
    for _ in range(8):
        u, v = int(rng.integers(0, 420 - 64)), int(rng.integers(0, 300 - 64))
        patch = image[v : v + 64, u : u + 64]
        if patch.std() < 8:
            continue
        score = cv2.matchTemplate(image, patch, cv2.TM_CCOEFF_NORMED)
        score[max(0, v - 16) : v + 17, max(0, u - 16) : u + 17] = -1
        assert score.max() < 0.985


@pytest.mark.parametrize("width", [1, 4, 5, 60])
@pytest.mark.parametrize("height", [1, 4, 7, 50])
def test_even_the_smallest_face_can_be_painted(width: int, height: int) -> None:
    for texture in SKINS.values():
        image = texture(Face(np.random.default_rng(0), height, width, 0.003))
        assert image.shape == (height, width, 3)
        assert np.all(np.isfinite(image))


def test_a_bare_wall_is_one_color() -> None:
    assert len(np.unique(paint(flat_color(RED)).reshape(-1, 3), axis=0)) == 1


def test_noise_has_equal_power_in_every_octave() -> None:
    noise = fractal_noise(np.random.default_rng(0), 512, 512, 256.0)
    assert 0.6 < noise.std() < 1.6
    bands = [
        float(np.std(cv2.GaussianBlur(noise, (0, 0), s) - cv2.GaussianBlur(noise, (0, 0), 2 * s)))
        for s in (1.0, 2.0, 4.0, 8.0, 16.0)
    ]
    assert max(bands) < 2.0 * min(bands)
