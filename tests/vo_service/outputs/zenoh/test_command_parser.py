"""Parsing of commands: every argument is checked, and each error is named."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Led
from vo_service.command_parser import COMMAND_NAMES, MAX_PAYLOAD_BYTES, parse_command
from vo_service.types import (
    CommandError,
    ErrorCode,
    LedCommand,
    LoadMapCommand,
    PauseCommand,
    ResetCommand,
    SaveMapCommand,
    StartRecordingCommand,
    TiltCommand,
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


@pytest.mark.parametrize(
    ("name", "payload", "words"),
    [
        ("tilt", b"", "'tilt_deg' is missing"),
        ("tilt", of(tilt_deg=90), "must be a number from -31 to 31"),
        ("tilt", of(tilt_deg="5"), "must be a number"),
        ("tilt", of(tilt_deg=True), "must be a number"),
        ("tilt", b'{"tilt_deg": NaN}', "must be a number"),
        ("tilt", b'{"tilt_deg": 1%s}' % (b"0" * 400), "must be a number"),
        ("tilt", of(tilt_deg=5, speed=2), "'speed' is not an argument of tilt; it takes: tilt_deg"),
        ("pause", of(now=True), "it takes: none"),
        ("led", of(led="pink"), "must be one of off, green"),
        ("start-recording", of(name="../etc"), "must be a plain name"),
        ("start-recording", of(name=""), "must be a plain name"),
        ("save-map", of(name="../etc"), "must be a plain name"),
        ("save-map", b"", "'name' is missing"),
        ("load-map", of(name="a/b"), "must be a plain name"),
        ("reset", of(position_m=[1, 2, 3]), "'quaternion_xyzw' is missing"),
        ("reset", of(position_m=[1, 2], quaternion_xyzw=[0, 0, 0, 1]), "a list of 3 numbers"),
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
@given(st.sampled_from(COMMAND_NAMES), st.binary() | JSON.map(lambda v: json.dumps(v).encode()))
def test_any_payload_gives_a_command_or_a_typed_error(name: str, payload: bytes) -> None:
    codes = []
    try:
        parse_command(name, payload)
    except CommandError as error:
        codes.append(error.code)
    assert codes in ([], [ErrorCode.BAD_REQUEST])
