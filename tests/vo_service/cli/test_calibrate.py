"""``calibrate``: from boards to a camera file, and what it says where that cannot be."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.calibration import CameraCalibration, read_calibration
from tests.simulators.fixtures import SimulateKinect
from tests.simulators.oni_writer import OniImage, OniSensor, write_oni
from tests.simulators.usb_frames import write_usb_frames
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from tests.vo_service.tools.calibration.board_snapshots import (
    VIEWS,
    each_image_is_searched_once,
    load_snapshots,
    record_snapshots,
    set_jackknife_groups,
)
from tests.vo_service.tools.calibration.rendered_boards import COLOR_LENS, DEPTH_LENS
from vo_service.tools.calibration.snapshot import Snapshot

OPTIONS = ("calibrate", "--board", "chessboard:9x6", "--square", "0.035")
FOUND = VIEWS - 1  # one is seen from too far aside


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Snapshot]:
    return load_snapshots(tmp_path_factory)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The photographs as a recording of unregistered depth in millimetres."""
    return record_snapshots(tmp_path_factory)


@pytest.fixture(scope="module", autouse=True)
def searched_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """See `each_image_is_searched_once`."""
    with each_image_is_searched_once(tmp_path_factory):
        yield


@pytest.fixture(autouse=True)
def surroundings_of_calibrate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few fits of standard deviations, and a folder for camera.toml."""
    set_jackknife_groups(monkeypatch, 5)
    monkeypatch.chdir(tmp_path)


def assert_is_the_cameras(camera: CameraCalibration, within_px: float = 1.0) -> None:
    assert camera.fx == pytest.approx(COLOR_LENS.fx, rel=0.005)
    assert camera.cx == pytest.approx(COLOR_LENS.cx, abs=within_px)
    assert camera.cy == pytest.approx(COLOR_LENS.cy, abs=within_px)
    if camera.depth is not None:
        assert camera.depth.fx == pytest.approx(DEPTH_LENS.fx, rel=0.01)
        assert camera.depth.T_color_depth.translation_m[0] == pytest.approx(-0.025, abs=0.004)


@pytest.mark.slow
def test_a_folder_gives_a_camera_file_a_table_and_a_figure(
    folder: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo(*OPTIONS, folder, "--depth", "--picture", "coverage.png")
    assert (outcome.code, outcome.error_lines) == (0, "")
    assert f"{FOUND} views of a chessboard of 9x6 inner corners, 640x480\n" in outcome.out
    assert outcome.out.endswith("saved as camera.toml: use it with --camera-file camera.toml, "
                                "or as camera.file\n")  # fmt: skip
    camera = read_calibration(tmp_path / "camera.toml")
    assert_is_the_cameras(camera)
    assert camera.depth is not None
    assert camera.depth.scale == pytest.approx(1.006, rel=0.005)
    assert cv2.imread("coverage.png") is not None


@pytest.mark.slow
def test_json_names_the_configured_file_that_is_written_and_the_old_one_that_is_kept(
    folder: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    (tmp_path / "kinect.toml").write_text('schema = 1\n[camera]\nfile = "lens.toml"\n')
    (tmp_path / "lens.toml").write_text("precious\n")
    outcome = kinect_vo(*OPTIONS, folder, "--config", "kinect.toml", "--json")
    result = json.loads(outcome.out)
    assert (result["views"], result["depth"]) == (FOUND, None)
    assert (Path(result["camera_file"]).name, Path(result["kept"]).name) == (
        "lens.toml",
        "lens.toml.bak",
    )
    assert (tmp_path / "lens.toml.bak").read_text() == "precious\n"
    assert_is_the_cameras(read_calibration(tmp_path / "lens.toml"))


def test_a_board_to_print_is_written(tmp_path: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo(*OPTIONS, "--print-board", "board.pdf")
    message = "board.pdf: chessboard of 9x6 inner corners, to print on A3 at 100 %\n"
    assert (outcome.code, outcome.out) == (0, message)
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")


def held(photographs: Sequence[Snapshot], frames: int) -> Iterator[Snapshot]:
    """Each stance for so many frames."""
    return (each for each in photographs for _ in range(frames))


@pytest.mark.subprocess
@pytest.mark.rerun
@pytest.mark.usefixtures("real_openni2")
def test_a_camera_of_openni2_is_calibrated_live_from_its_raw_images(
    photographs: Sequence[Snapshot], tmp_path: Path, kinect_vo: KinectVo
) -> None:
    images = [
        image
        for n, each in enumerate(held(photographs, 2))
        for image in (
            OniImage(OniSensor.DEPTH, n * 33333, each.depth_raw),
            OniImage(OniSensor.COLOR, n * 33333, each.color_bgr),
        )
    ]
    write_oni(tmp_path / "boards.oni", images)
    camera = ("--camera", "openni2:boards.oni", "--views", "18", "--depth", "--keep", "views")
    watched = ("--output", "live.toml", "--rerun", "watched.rrd")
    assert kinect_vo(*OPTIONS, *camera, *watched).code == 0
    live = read_calibration(tmp_path / "live.toml")
    assert (tmp_path / "watched.rrd").stat().st_size > 100_000
    assert_is_the_cameras(live)
    # What was kept is what was seen: it calibrates to the same.
    assert kinect_vo(*OPTIONS, "views", "--depth", "--output", "again.toml").code == 0
    assert read_calibration(tmp_path / "again.toml") == live


@pytest.mark.subprocess
@pytest.mark.usefixtures("real_libfreenect")
def test_a_kinect_is_calibrated_live_from_its_raw_images(
    photographs: Sequence[Snapshot],
    tmp_path: Path,
    simulate_kinect: SimulateKinect,
    kinect_vo: KinectVo,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A busy machine may miss a board and take it in the next round. The standard deviations depend
    # on this order (here from 1.3 to 3.2 px), unless each group is one view.
    set_jackknife_groups(monkeypatch, FOUND)
    # In between nobody holds the board, so that no image of it meets the depth of the board before.
    nothing = np.full((480, 640, 3), 128, np.uint8)
    images = [
        (color, each.depth_raw)
        for each in photographs
        for color in (nothing, *[each.color_bgr] * 5)
    ]
    kinect = simulate_kinect(write_usb_frames(tmp_path, images))
    kinect.rate = 10
    kinect.activate()
    outcome = kinect_vo(*OPTIONS, "--camera", "freenect", "--views", str(FOUND), "--depth")
    assert outcome.code == 0, outcome.err
    # Bayer's mosaic and 11 bits of depth cost something.
    assert_is_the_cameras(read_calibration(tmp_path / "camera.toml"), within_px=2.0)


def write_gray(folder: Path, names: Sequence[str]) -> Path:
    folder.mkdir()
    for name in names:
        assert cv2.imwrite(str(folder / name), np.full((480, 640, 3), 128, np.uint8))
    return folder


def test_images_without_the_board_give_advice(tmp_path: Path, kinect_vo: KinectVo) -> None:
    write_gray(tmp_path / "gray", ["a.png", "b.png"])
    outcome = kinect_vo(*OPTIONS, "gray")
    message = (
        "gray: none of the 2 images shows a chessboard of 9x6 inner corners; check that --board"
    )
    assert_one_line(outcome, 2, message)
    assert not (tmp_path / "camera.toml").exists()


@pytest.fixture
def few(folder: Path, tmp_path: Path) -> Path:
    """Three of the photographs."""
    few = tmp_path / "few"
    few.mkdir()
    for file in sorted((folder / "rgb").iterdir())[:3]:
        (few / file.name).write_bytes(file.read_bytes())
    return few


@pytest.mark.slow
def test_images_of_another_board_name_it(few: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("calibrate", "--board", "chessboard:8x6", "--square", "0.035", few)
    assert_one_line(outcome, 2, "but some show another board; use --board chessboard:9x6")


@pytest.mark.slow
def test_a_wrong_square_size_is_detected_by_depth_and_nothing_is_saved(
    folder: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo("calibrate", "--square", "0.025", folder, "--depth")
    assert_one_line(outcome, 1, "times as far away as measured by depth; measure --square again")
    assert not (tmp_path / "camera.toml").exists()


MISTAKES = {
    "no source": ([], "name a FOLDER of images, or a camera"),
    "two sources": (["x", "--camera", "freenect"], "name a FOLDER of images, or a camera"),
    "no images": (["."], ".: has no images"),
    "no lists": ([".", "--depth"], "rgb.txt: no such file"),
    "no folder for it": ([".", "--output", "gone/camera.toml"], "there is no folder gone"),
    "a folder": ([".", "--output", "."], ".: is a folder"),
    "picture": ([".", "--picture", "coverage.gif"], "the file name must end in .png or .svg"),
    "board": ([".", "--board", "checkers:8x8"], "--board checkers:8x8: is not a board"),
    "nothing to keep": ([".", "--keep", "views"], "--keep keeps what a camera shows"),
    "nothing to watch": ([".", "--rerun", "serve"], "--rerun shows what a camera sees"),
    "topics of a camera": (["--camera", "bag:a", "--topics", "a", "b"], "it goes with a FOLDER"),
    "watch where": (["--camera", "tum:.", "--rerun", "x"], "rerun target 'x': use serve"),
    "no views": (["--camera", "freenect", "--views", "0"], "--views 0: give 1 or more"),
    "virtual": (["--camera", "synthetic"], "never shows a board"),
    "camera": (["--camera", "kinekt"], "camera 'kinekt' is unknown"),
    "print": (["--print-board", "board.doc"], "the file name must end in .pdf or .svg or .png"),
    "print where": (["--print-board", "gone/board.pdf"], "there is no folder gone"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line(mistake: str, kinect_vo: KinectVo) -> None:
    arguments, message = MISTAKES[mistake]
    assert_one_line(kinect_vo("calibrate", "--square", "0.025", *arguments), 2, message)


def test_the_size_of_a_square_is_required_in_meters(kinect_vo: KinectVo) -> None:
    message = "25 is out of range: give meters, such as 0.025 for 25 mm"
    assert_one_line(kinect_vo("calibrate", ".", "--square", "25"), 2, message)
