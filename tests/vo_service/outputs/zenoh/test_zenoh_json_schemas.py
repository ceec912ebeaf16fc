"""The schemas agree with the messages, the parser, the files and the documentation."""

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Led
from scripts.write_reference import SCHEMA_FOLDER, make_files
from tests.json_schema import schema_errors
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.sample_map import make_map
from vo_service.outputs.zenoh.json_schemas import JSON_SCHEMA_DIALECT, all_schemas, schema_of
from vo_service.types.commands import COMMANDS, CommandError, ErrorCode, parse_command
from vo_service.types.messages import (
    ErrorReply,
    LatencyReport,
    RecorderReport,
    encode_message,
    map_odom_attachment,
    pose_attachment,
    versions,
)

SCHEMAS = all_schemas()
PAGE = (Path(__file__).parents[4] / "docs" / "reference" / "errors.md").read_text()

plain = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
numbers = st.lists(st.floats(-2.0, 2.0) | st.integers(-1, 1), min_size=2, max_size=5)
name = st.from_regex(r"[A-Za-z0-9_.-]{0,70}", fullmatch=True)
values = plain | numbers | name | st.sampled_from(list(Led)) | st.floats(-40.0, 40.0)
keys = st.sampled_from(["position_m", "quaternion_xyzw", "tilt_deg", "led", "name"]) | st.text()
arguments = st.dictionaries(keys, values, max_size=3)


@pytest.mark.parametrize("schema", SCHEMAS.values(), ids=SCHEMAS.keys())
def test_a_schema_has_its_draft_and_title(schema: Mapping[str, Any]) -> None:
    assert schema["$schema"] == JSON_SCHEMA_DIALECT
    assert schema["title"]
    assert json.loads(json.dumps(schema)) == schema


def test_schemas_and_tables_are_those_that_the_code_generates() -> None:
    files = make_files()
    assert set(SCHEMA_FOLDER.glob("*.json")) <= files.keys()
    outdated = [file.name for file, text in files.items() if file.read_text() != text]
    assert outdated == [], "run scripts/write_reference.py and look at what has changed"


def test_a_status_is_valid_and_has_only_fields_of_the_schema() -> None:
    full = dataclasses.replace(
        STATUS,
        warnings=("a", "b"),
        latency=LatencyReport(stage_ms={"surf": 4.5}),
        paused=True,
        recorder=RecorderReport("desk"),
    )
    for each in (STATUS, full):
        content = json.loads(encode_message(each, {"versions": versions()}))
        assert schema_errors(SCHEMAS["status"], content) == []
        assert content.keys() == SCHEMAS["status"]["properties"].keys()


@pytest.mark.parametrize(
    ("group", "key", "wrong"),
    [
        ("", "state", "asleep"),
        ("", "warnings", [1]),
        ("latency", "fps", "30"),
        ("latency", "stage_ms", {"a": "b"}),
        ("map", "is_localized", 1),
    ],
)
def test_a_wrong_status_is_invalid(group: str, key: str, wrong: object) -> None:
    content = json.loads(encode_message(STATUS, {"versions": versions()}))
    (content[group] if group else content)[key] = wrong
    assert len(schema_errors(SCHEMAS["status"], content)) == 1


def test_attachments_and_errors_are_valid() -> None:
    for ok in (True, False):
        content = json.loads(pose_attachment(make_update(3, ok=ok)))
        assert schema_errors(SCHEMAS["odom-attachment"], content) == []
        assert content.keys() == SCHEMAS["odom-attachment"]["properties"].keys()
        on_map = json.loads(
            map_odom_attachment(dataclasses.replace(make_update(3), map=make_map()))
        )
        assert schema_errors(SCHEMAS["map-odom-attachment"], on_map) == []
        assert on_map.keys() == SCHEMAS["map-odom-attachment"]["properties"].keys()
    for code in ErrorCode:
        content = json.loads(encode_message(ErrorReply(code, "why")))
        assert schema_errors(SCHEMAS["error"], content) == []


def test_every_command_has_its_two_schemas() -> None:
    parts = {f"{command}-{part}" for command in COMMANDS for part in ("arguments", "answer")}
    attachments = {"odom-attachment", "map-odom-attachment", "frame-attachment"}
    others = {"status", "timing", "error"} | attachments
    assert parts | others == SCHEMAS.keys()


@given(st.sampled_from(list(COMMANDS)), arguments)
def test_arguments_are_valid_if_the_parser_accepts_them(
    command: str, arguments: dict[str, Any]
) -> None:
    payload = json.dumps(arguments).encode()
    is_valid = schema_errors(SCHEMAS[f"{command}-arguments"], json.loads(payload)) == []
    refusal = refusal_of(command, payload)
    # JSON Schema cannot ask for a quaternion's length.
    assert is_valid == (refusal == "" or "length 1" in refusal)


def refusal_of(command: str, payload: bytes) -> str:
    """Return why the parser refuses a command; "" if it does not."""
    try:
        parse_command(command, payload)
    except CommandError as error:
        return str(error)
    return ""


def test_a_type_without_a_schema_is_an_error() -> None:
    with pytest.raises(TypeError, match="no schema"):
        schema_of(set[int])


@pytest.mark.parametrize("code", ErrorCode)
def test_the_documentation_names_each_error(code: ErrorCode) -> None:
    assert f"`{code}`" in PAGE
