from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.calibration import CameraCalibration, format_calibration
from drivers.camera import PinholeCamera, RgbdFrame

WIDTH, HEIGHT = 64, 48
PINHOLE = PinholeCamera(WIDTH, HEIGHT, 60.0, 61.0, 31.5, 23.5)
CAMERA = CameraCalibration(WIDTH, HEIGHT, 60.0, 61.0, 31.5, 23.5, (0.0,) * 5, 5000.0, 0.02)

FolderMaker = Callable[..., Path]


def color_image(seed: int) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 2)  # type: ignore[return-value]


def depth_image(seed: int) -> NDArray[np.uint16]:
    return np.random.default_rng(seed).integers(0, 20000, (HEIGHT, WIDTH), dtype=np.uint16)


@pytest.fixture
def make_folder(tmp_path: Path) -> FolderMaker:
    """Write a folder of `count` frames with real images, depth `skew_s` after color."""

    def make(
        count: int = 5, period_s: float = 0.04, skew_s: float = 0.005, kind: str = "png"
    ) -> Path:
        folder = tmp_path / "recording"
        (folder / "rgb").mkdir(parents=True)
        (folder / "depth").mkdir()
        lists = {"rgb": ["# color"], "depth": ["# depth"]}
        for k in range(count):
            stamp_s = 1305031102.175304 + k * period_s
            images = {"rgb": (stamp_s, kind), "depth": (stamp_s + skew_s, "png")}
            for name, (instant_s, extension) in images.items():
                file = f"{name}/{instant_s:.6f}.{extension}"
                image = color_image(k) if name == "rgb" else depth_image(k)
                assert cv2.imwrite(str(folder / file), image)
                lists[name].append(f"{instant_s:.6f} {file}")
        for name, lines in lists.items():
            (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
        (folder / "camera.toml").write_text(format_calibration(CAMERA))
        return folder

    return make


def make_frame(seq: int = 0, **fields: object) -> RgbdFrame:
    """Frame number `seq` of a camera, with any field replaced."""
    values = {
        "seq": seq,
        "stamp_s": 1000.0 + seq / 30,
        "receive_time_s": 0.0,
        "color_bgr": color_image(seq),
        "depth_raw": depth_image(seq),
        "depth_factor": 5000.0,
        "camera": PINHOLE,
        "skew_s": 0.01,
    }
    return RgbdFrame(**(values | fields))  # type: ignore[arg-type]
