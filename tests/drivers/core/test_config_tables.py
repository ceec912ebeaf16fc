"""Configuration files: values, mistakes with their line, and lines that are changed."""

import json
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError
from drivers.core.config import Field, find_key_lines, parse_toml, read_toml


class Shade(StrEnum):
    LIGHT = "light"
    DARK = "dark"


@dataclass(frozen=True)
class Lamp:
    power_w: Annotated[float, Field("electric power", exclusive_minimum=0.0, maximum=100.0)] = 5.0
    shade: Annotated[Shade, "color of the shade"] = Shade.LIGHT


@dataclass(frozen=True)
class Room:
    width: Annotated[int, Field("meters from wall to wall", minimum=1)]
    name: Annotated[str, "what people call it"] = "kitchen"
    heated: Annotated[bool, "has a stove"] = False
    corner: Annotated[tuple[float, float], Field("where it starts", minimum=-10.0)] = (0.0, 0.0)
    tags: list[str] = field(default_factory=list)
    plan: Annotated[Path | None, "drawing of the room"] = None
    lamp: Lamp = Lamp()

    def __post_init__(self) -> None:
        if self.name == "void":
            raise ValueError("a room cannot be void")


def room(text: str) -> Room:
    return parse_toml("schema = 1\n" + text, "room.toml", Room)


def complaint(text: str) -> str:
    with pytest.raises(InputError) as caught:
        room(text)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_complete_file_becomes_the_dataclass() -> None:
    read = room(
        'width = 4\nname = "hall"\nheated = true\ncorner = [1, -2.5]\ntags = ["a", "b"]\n'
        'plan = "plans/hall.png"\n[lamp]\npower_w = 40\nshade = "dark"\n'
    )
    plan = Path("plans/hall.png")
    assert read == Room(4, "hall", True, (1.0, -2.5), ["a", "b"], plan, Lamp(40.0, Shade.DARK))
    assert type(read.lamp.power_w) is float


def test_an_unknown_key_is_reported_with_its_line_and_the_likely_key() -> None:
    assert complaint("width = 4\nheeted = true") == (
        "room.toml:3: key `heeted`: is unknown; did you mean `heated`?"
    )


def test_an_unknown_key_without_a_similar_one_gets_the_list_of_keys() -> None:
    assert complaint("width = 4\n\n[lamp]\nzzz = 1").endswith(
        "room.toml:5: key `lamp.zzz`: is unknown; known here: power_w, shade"
    )


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ('width = "4"', "a whole number"),
        ("width = 4.0", "a whole number"),
        ("width = true", "a whole number"),
        ("name = 3", "text in double quotes"),
        ("heated = 1", "true or false"),
        ("corner = 1", "a list of 2"),
        ("corner = [1, 2, 3]", "a list of 2"),
        ("corner = [1, true]", "a number"),
        ("tags = [1]", "text in double quotes"),
        ("plan = 2024-01-01", "text in double quotes"),
        ("lamp = 3", "a table"),
        ("lamp = { power_w = '5' }", "a number"),
    ],
)
def test_a_wrong_type_is_refused_at_its_line(line: str, wanted: str) -> None:
    key = line.split(" =")[0]
    message = complaint(line if key == "width" else f"width = 4\n{line}")
    assert message.startswith(f"room.toml:{2 if key == 'width' else 3}: key `{key}")
    assert f"is the wrong type; give {wanted}" in message


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "+nan"])
def test_numbers_must_be_finite(number: str) -> None:
    assert "not allowed; give a finite number" in complaint(f"width = 4\nlamp.power_w = {number}")


@pytest.mark.parametrize(("power", "ok"), [("0", False), ("1e-9", True), ("100", True)])
def test_values_out_of_range_are_rejected(power: str, ok: bool) -> None:
    text = f"width = 4\n[lamp]\npower_w = {power}"
    if ok:
        assert room(text).lamp.power_w == float(power)
    else:
        assert complaint(text) == (
            "room.toml:4: key `lamp.power_w`: 0 is out of range; "
            "give more than 0 and at most 100 (electric power)"
        )


def test_ranges_apply_to_each_value_of_a_list() -> None:
    assert "-11 is out of range; give at least -10" in complaint("width = 4\ncorner = [0, -11]")


def test_a_missing_required_key_is_reported_with_its_meaning() -> None:
    assert complaint("name = 'x'") == (
        "room.toml: key `width`: is missing; add `width = ...` (meters from wall to wall)"
    )


def test_an_invalid_choice_gets_the_likely_one_and_the_list() -> None:
    message = complaint('width = 4\n[lamp]\nshade = "drak"')
    assert message.endswith('"drak" is not a choice; did you mean `dark`? known here: light, dark')


def test_a_check_across_keys_is_reported_with_the_file() -> None:
    assert complaint('width = 4\nname = "void"') == "room.toml: a room cannot be void"


@pytest.mark.parametrize(
    ("text", "line"), [("width = = 4", 2), ("width = [1,\n2", 3), ("width = 4\nwidth = 5", 3)]
)
def test_a_syntax_error_is_reported_with_its_line(text: str, line: int) -> None:
    assert complaint(text).startswith(f"room.toml:{line}: not TOML: ")


@pytest.mark.parametrize("version", ["2", "0", "true", '"1"', "1.0"])
def test_another_schema_is_rejected_with_instructions(version: str) -> None:
    with pytest.raises(InputError, match=r"room\.toml:2: key `schema`: version .* install the kin"):
        parse_toml(f"\nschema = {version}\nwidth = 4", "room.toml", Room)


def test_a_file_without_a_schema_is_refused() -> None:
    with pytest.raises(InputError, match="key `schema`: is missing; put `schema = 1` at the top"):
        parse_toml("width = 4", "room.toml", Room)


def test_absurd_numbers_and_nesting_are_refused_not_a_crash() -> None:
    assert "out of range" in complaint(f"width = 4\nlamp.power_w = 1{'0' * 400}")
    assert "too large" in complaint(f"width = 4\ncorner = [1{'0' * 400}, 0]")
    assert "not TOML" in complaint(f"width = {'[' * 5000}")
    assert "not TOML" in complaint(f"width = {'9' * 5000}")


def test_an_unreadable_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_toml(tmp_path / "none.toml", Room)
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe9'")
    with pytest.raises(InputError, match=r"latin.toml:1: is not UTF-8 text"):
        read_toml(tmp_path / "latin.toml", Room)


def test_a_file_without_end_is_refused() -> None:
    with pytest.raises(InputError, match="/dev/zero: cannot be read: it is a device, not"):
        read_toml(Path("/dev/zero"), Room)


def test_texts_that_no_path_can_be_are_refused() -> None:
    unusable = "room.toml:3: key `plan`: the character \\u0000 is not allowed; remove it"
    assert complaint('width = 4\nplan = "a\\u0000"') == unusable
    assert 'key `plan`: "~/hall.png": write the home' in complaint('width = 4\nplan = "~/hall.png"')
    assert "key `plan`: is empty; give a path" in complaint('width = 4\nplan = ""')


def test_a_byte_order_mark_and_dos_line_ends_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "dos.toml").write_bytes(b"\xef\xbb\xbfschema = 1\r\nwidth = 4\r\n")
    assert read_toml(tmp_path / "dos.toml", Room) == Room(4)


@given(
    st.integers(1, 10**6),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")).filter(
        lambda name: name != "void"
    ),
    st.floats(0.0, 100.0, exclude_min=True),
)
def test_written_values_are_read_back_exactly(width: int, name: str, power_w: float) -> None:
    # A JSON string is a TOML string but for DEL, which TOML wants escaped.
    quoted = json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
    text = f"width = {width}\nname = {quoted}\nlamp.power_w = {power_w!r}"
    assert room(text) == Room(width, name, lamp=Lamp(power_w))


TEXT = '''# a comment = 1
top = 1
multi = """
fake = 1
[fake]
"""
list = [
  1, # [x]
  2,
]
a.b.c = 1

[table]
key = 'x'
"quoted.key" = 2
inline = { p = 1, q = { r = 2 } }
[table.sub]  # header
key = 3
[[rows]]
key = 1
[[rows]]
[rows.sub]
key = 2
'''


def test_every_key_has_its_line() -> None:
    lines = find_key_lines(TEXT)
    assert lines == {
        ("top",): 2,
        ("multi",): 3,
        ("list",): 7,
        ("a",): 11,
        ("a", "b"): 11,
        ("a", "b", "c"): 11,
        ("table",): 13,
        ("table", "key"): 14,
        ("table", "quoted.key"): 15,
        ("table", "inline"): 16,
        ("table", "inline", "p"): 16,
        ("table", "inline", "q"): 16,
        ("table", "inline", "q", "r"): 16,
        ("table", "sub"): 17,
        ("table", "sub", "key"): 18,
        ("rows",): 19,
        ("rows", "[0]"): 19,
        ("rows", "[0]", "key"): 20,
        ("rows", "[1]"): 21,
        ("rows", "[1]", "sub"): 22,
        ("rows", "[1]", "sub", "key"): 23,
    }
