"""The configuration file: its tables, its defaults, and every mistake named by line and key."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.core import InputError
from drivers.core.geometry import R_BODY_OPTICAL, rigid_transform
from vo_service.config import Config, read_config

WHOLE = """\
schema = 1
[camera]
source = "tum:desk"
file = "camera.toml"
stamp_offset_s = -0.02
[odometry]
method = "surf"
feature_count = 500
upright = true
[T_base_camera]
translation_m = [0.1, 0, 0.4]
quaternion_xyzw = [0, 0, 0, 1]
[zenoh]
prefix = "robot1/kinect"
listen = []
connect = ["tcp/192.168.1.2:7447"]
config_file = "zenoh.json5"
[ros2]
odom_frame_id = "o"
base_frame_id = "b"
[rerun]
targets = ["serve", "run.rrd"]
[synthetic]
seed = 7
duration_s = 2
[synthetic.color]
noise_sigma = 0.0
[[synthetic.faults]]
kind = "black"
first = 5
"""


def read(tmp_path: Path, text: str) -> Config:
    file = tmp_path / "kinect.toml"
    file.write_text(text)
    return read_config(file)


def mistake(tmp_path: Path, text: str) -> str:
    """What is said about a file, without the folder."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{tmp_path}/")


def test_without_a_file_everything_has_its_default() -> None:
    config = read_config(None)
    assert (config.camera.source, config.odometry.method) == ("synthetic", "direct")
    assert config.zenoh.listen == ("tcp/127.0.0.1:7450",)
    assert (config.zenoh.prefix, config.zenoh.connect, config.rerun.targets) == ("kinect", (), ())


def test_an_empty_file_has_all_defaults(tmp_path: Path) -> None:
    assert read(tmp_path, "schema = 1\n") == read_config(None)


def test_the_shipped_example_has_exactly_the_defaults() -> None:
    example = Path(__file__).parents[2] / "config" / "kinect.toml"
    assert read_config(example) == read_config(None)


def test_the_example_of_a_robot_is_a_planar_base_with_wheels() -> None:
    config = read_config(Path(__file__).parents[2] / "config" / "robot.toml")
    assert config.base.planar
    assert config.wheel_odometry.enabled
    assert config.T_base_camera.T_base_camera[2, 3] == 0.6


@pytest.mark.parametrize("height_m", [0.0, -0.5])
def test_a_planar_base_needs_the_height_of_its_camera(tmp_path: Path, height_m: float) -> None:
    mount = f"[T_base_camera]\ntranslation_m = [0.1, 0.0, {height_m}]\n"
    with pytest.raises(InputError, match=r"T_base_camera\.translation_m.*camera's height above"):
        read(tmp_path, f"schema = 1\n[base]\nplanar = true\n{mount}")


def test_every_table_is_read(tmp_path: Path) -> None:
    config = read(tmp_path, WHOLE)
    assert config.camera.source == "tum:desk"
    assert (config.camera.file, config.camera.stamp_offset_s) == (Path("camera.toml"), -0.02)
    assert (config.odometry.feature_count, config.odometry.upright) == (500, True)
    assert (config.zenoh.prefix, config.zenoh.listen) == ("robot1/kinect", ())
    assert config.zenoh.connect == ("tcp/192.168.1.2:7447",)
    assert (config.ros2.odom_frame_id, config.ros2.base_frame_id) == ("o", "b")
    assert config.rerun.targets == ("serve", "run.rrd")
    assert (config.synthetic.seed, config.synthetic.duration_s) == (7, 2.0)
    assert config.synthetic.color.noise_sigma == 0.0
    assert config.synthetic.faults[0].first == 5


def test_a_camera_mounting_becomes_a_transform(tmp_path: Path) -> None:
    T = read(tmp_path, WHOLE).T_base_camera.T_base_camera
    np.testing.assert_array_equal(T, rigid_transform(np.eye(3), [0.1, 0.0, 0.4]))


@pytest.mark.parametrize(
    ("tables", "has_recorder"),
    [
        ("", True),
        ("[recorder]\nenabled = false\n", False),
        ('[odometry]\nprofile = "small"\n', False),
        ('[odometry]\nprofile = "small"\n[recorder]\nenabled = true\n', True),
    ],
)
def test_the_small_profile_has_no_flight_recorder_unless_the_file_says_so(
    tmp_path: Path, tables: str, has_recorder: bool
) -> None:
    assert read(tmp_path, f"schema = 1\n{tables}").has_recorder is has_recorder


def test_the_default_mounting_looks_straight_ahead_from_the_base() -> None:
    T = read_config(None).T_base_camera.T_base_camera
    np.testing.assert_array_equal(T, rigid_transform(R_BODY_OPTICAL, [0.0, 0.0, 0.0]))


def test_a_camera_ahead_of_the_base_keeps_the_default_axes(tmp_path: Path) -> None:
    config = read(tmp_path, "schema = 1\n[T_base_camera]\ntranslation_m = [0.3, 0.0, 0.5]\n")
    expected = rigid_transform(R_BODY_OPTICAL, [0.3, 0.0, 0.5])
    np.testing.assert_allclose(config.T_base_camera.T_base_camera, expected, atol=1e-15)


@pytest.mark.parametrize(
    ("table", "line", "where"),
    [
        ("camera", 'sorce = "synthetic"', "key `camera.sorce`: is unknown; did you mean `source`?"),
        (
            "camera",
            'source = "frenect"',
            "key `camera.source`: camera 'frenect' is unknown; did",
        ),
        ("odometry", 'method = "orb"', "key `odometry.method`: 'orb' is unknown; known here: surf"),
        ("odometry", 'timing = "learnt"', "key `odometry.timing`: 'learnt' is unknown; did you"),
        ("odometry", 'profile = "smal"', "key `odometry.profile`: 'smal' is unknown; did you"),
        ("outputs", 'extra = ["file:x"]', "key `outputs.extra`: output 'file:x' is unknown; "),
        (
            "outputs",
            'extra = ["trajectory:"]',
            "key `outputs.extra`: output 'trajectory:' names no file; use",
        ),
        ("camera", "stamp_offset_s = 60", "key `camera.stamp_offset_s`: 60 is out of range"),
        ("odometry", "feature_count = 49", "key `odometry.feature_count`: 49 is out of range"),
        (
            "T_base_camera",
            "translation_m = [120, 0, 0]",
            "key `T_base_camera.translation_m`: 120 is",
        ),
        ("map", 'load = "../x"', 'key `map.load`: "../x" is not valid; give a plain name'),
        ("recorder", f"max_mb = 1{'0' * 13}", "key `recorder.max_mb`: 10000000000000 is"),
        ("synthetic", "rate_hz = 0", "key `synthetic.rate_hz`: 0 is out of range"),
        ("synthetic.depth", "shadow = true", "key `synthetic.depth.shadow`: is unknown; did you"),
    ],
)
def test_a_wrong_key_is_reported_with_its_line(
    tmp_path: Path, table: str, line: str, where: str
) -> None:
    text = f"schema = 1\n# a comment\n[{table}]\n{line}\n"
    assert mistake(tmp_path, text).startswith(f"kinect.toml:4: {where}")


@pytest.mark.parametrize(
    ("table", "line", "why"),
    [
        ("T_base_camera", "quaternion_xyzw = [0, 0, 0, 0]", "must have length 1, as x y z w"),
        ("T_base_camera", "quaternion_xyzw = [1, 1, 1, 1]", "must have length 1, as x y z w"),
        ("zenoh", 'prefix = "/kinect"', "without a slash at either end"),
        ("ros2", 'odom_frame_id = ""', "is empty or the name of another frame"),
        ("ros2", 'base_frame_id = "odom"', "is empty or the name of another frame"),
        ("ros2", 'odom_frame_id = "/odom"', "which tf2 refuses; give 'odom'"),
        ("zenoh", 'listen = ["tcp/[::1]:1", "tcp/[::1]:1"]', "the same endpoint twice"),
        ("synthetic", "duration_s = 0.01", "must hold at least one frame"),
    ],
)
def test_an_invalid_value_is_reported_with_its_key(
    tmp_path: Path, table: str, line: str, why: str
) -> None:
    message = mistake(tmp_path, f"schema = 1\n\n[{table}]\n{line}\n")
    assert message.startswith(f"kinect.toml:4: key `{table}.{line.partition(' =')[0]}`: ")
    assert why in message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[zeno]\n", "kinect.toml: key `schema`: is missing; put `schema = 1` at the top"),
        ("schema = 1\n[zeno]\n", "kinect.toml:2: key `zeno`: is unknown; did you mean `zenoh`?"),
        ("schema = 2\n", "kinect.toml:1: key `schema`: version 2 cannot be read, only 1"),
        ("schema = 1\n[camera\n", "kinect.toml:2: not TOML"),
        ("schema = 1\ncamera = 3\n", "kinect.toml:2: key `camera`: 3 is the wrong type"),
    ],
)
def test_an_invalid_file_is_reported(tmp_path: Path, text: str, message: str) -> None:
    assert mistake(tmp_path, text).startswith(message)


def test_a_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: cannot be read: No such file"):
        read_config(tmp_path / "none.toml")


EXAMPLE = Path(__file__).parents[2] / "config" / "kinect.toml"
TABLES = [field.name for field in dataclasses.fields(Config) if field.name != "synthetic"]


@pytest.mark.parametrize("table", TABLES)
def test_the_example_shows_every_key(table: str) -> None:
    text = re.split(r"\n(?:# )?\[", EXAMPLE.read_text().split(f"[{table}]")[1])[0]
    section: Any = getattr(Config(), table)
    keys = {field.name for field in dataclasses.fields(section)}
    assert set(re.findall(r"^(?:# )?(\w+) = ", text, re.MULTILINE)) == keys
