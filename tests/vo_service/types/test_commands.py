"""Commands: every argument is checked, and each error is named."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Led
from drivers.core import InputError
from drivers.core.geometry import rigid_transform, so3_exp
from vo_service.types.commands import (
    COMMANDS,
    MAX_PAYLOAD_BYTES,
    CommandError,
    ErrorCode,
    LedCommand,
    LoadMapCommand,
    PauseCommand,
    ResetCommand,
    SaveMapCommand,
    StartRecordingCommand,
    TiltCommand,
    parse_command,
)


def refusal(name: str, payload: bytes) -> CommandError:
    with pytest.raises(CommandError) as raised:
        parse_command(name, payload)
    return raised.value


def of(**arguments: Any) -> bytes:
    return json.dumps(arguments).encode()


def test_commands_without_arguments_need_no_payload() -> None:
    assert parse_command("pause", b"") == PauseCommand()
    assert parse_command("pause", b"{}") == PauseCommand()
    assert parse_command("reset", b"") == ResetCommand()


def test_arguments_are_parsed() -> None:
    assert parse_command("tilt", of(tilt_deg=-5)) == TiltCommand(-5.0)
    assert parse_command("led", of(led="red")) == LedCommand(Led.RED)
    assert parse_command("start-recording", of(name="desk-1")) == StartRecordingCommand("desk-1")
    assert parse_command("save-map", of(name="kitchen")) == SaveMapCommand("kitchen")
    assert parse_command("load-map", of(name="kitchen")) == LoadMapCommand("kitchen")


def test_a_reset_may_have_a_pose() -> None:
    command = parse_command("reset", of(position_m=[1, 2, 3], quaternion_xyzw=[0, 0, 1, 0]))
    assert isinstance(command, ResetCommand)
    assert command.T_odom_base is not None
    np.testing.assert_allclose(command.T_odom_base[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(np.diag(command.T_odom_base), [-1, -1, 1, 1], atol=1e-12)


def test_a_pose_in_32_bits_is_rigid_enough() -> None:
    T_odom_base = rigid_transform(so3_exp([0.1, -0.2, 2.0]), [1, 2, 3])
    command = ResetCommand.to_pose(T_odom_base.astype(np.float32).astype(np.float64))
    assert command.position_m == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("T", [np.full((4, 4), np.nan), np.eye(3), 2 * np.eye(4), "x"])
def test_a_matrix_that_is_not_a_pose_is_rejected(T: Any) -> None:
    with pytest.raises(InputError, match="T_odom_base: give a 4x4 matrix of finite numbers"):
        ResetCommand.to_pose(T)


@pytest.mark.parametrize(
    ("name", "payload", "words"),
    [
        ("tilt", b"", "argument `tilt_deg` is missing"),
        (
            "tilt",
            of(tilt_deg=90),
            "`tilt_deg` 90 is out of range; give at least -31 and at most 31",
        ),
        (
            "tilt",
            of(tilt_deg="5"),
            '"5" is the wrong type; give a number, at least -31 and at most 31 (degrees above',
        ),
        ("tilt", of(tilt_deg=True), "true is the wrong type; give a number, at least -31"),
        ("tilt", b'{"tilt_deg": NaN}', "give a finite number"),
        ("tilt", b'{"tilt_deg": 1%s}' % (b"0" * 400), "is out of range"),
        ("tilt", of(tilt_deg=5, speed=2), "`speed` is unknown; known here: tilt_deg"),
        ("pause", of(now=True), "`now` is unknown; known here: none"),
        ("led", of(led="pink"), "is not a choice; known here: off, green"),
        ("start-recording", of(name="../etc"), "give a plain name"),
        ("start-recording", of(name=""), "give a plain name"),
        ("start-recording", of(name=".hidden"), "give a plain name"),
        ("start-recording", of(name="a b"), "give a plain name"),
        ("start-recording", of(name="a\n"), "give a plain name"),
        ("start-recording", of(name="x" * 65), "give a plain name"),
        ("save-map", of(name="../etc"), "give a plain name"),
        ("save-map", b"", "`name` is missing"),
        ("load-map", of(name="a/b"), "give a plain name"),
        ("reset", of(position_m=[1, 2, 3]), "give position_m and quaternion_xyzw, or none of them"),
        (
            "reset",
            of(position_m=[1, 2], quaternion_xyzw=[0, 0, 0, 1]),
            "a list of 2 is the wrong type; give a list of 3",
        ),
        ("reset", of(position_m=[0, 0, 0], quaternion_xyzw=[0, 0, 0, 0.5]), "length 1"),
        ("reset", b"[1, 2]", "not a JSON object"),
        ("reset", b"\xff", "not JSON"),
        ("reset", b"[" * 4000, "not JSON"),
    ],
)
def test_a_wrong_argument_is_reported(name: str, payload: bytes, words: str) -> None:
    error = refusal(name, payload)
    assert error.code is ErrorCode.BAD_REQUEST
    assert words in str(error)


@pytest.mark.parametrize("quaternion", [None, (0.0, 0.0, 0.0, 2.0)])
def test_a_reset_without_a_whole_pose_is_a_wrong_argument(
    quaternion: tuple[float, float, float, float] | None,
) -> None:
    with pytest.raises(InputError, match="quaternion_xyzw"):
        ResetCommand((1.0, 2.0, 3.0), quaternion)


def test_an_unknown_command_gets_the_list_of_commands() -> None:
    error = refusal("explode", b"")
    assert error.code is ErrorCode.UNKNOWN_COMMAND
    assert "save-incident" in str(error)


def test_an_oversize_payload_is_not_parsed() -> None:
    assert "too many" in str(refusal("pause", b" " * (MAX_PAYLOAD_BYTES + 1)))


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


@pytest.mark.slow
@given(st.sampled_from(list(COMMANDS)), st.binary() | JSON.map(lambda v: json.dumps(v).encode()))
def test_any_payload_gives_a_command_or_a_typed_error(name: str, payload: bytes) -> None:
    codes = []
    try:
        parse_command(name, payload)
    except CommandError as error:
        codes.append(error.code)
    assert codes in ([], [ErrorCode.BAD_REQUEST])
