"""Types of Numba as JSON, and back."""

import json
from typing import Any

import numba
import numpy as np
import pytest

from vo_service.kernels.argument_types import from_json, to_json
from vo_service.navigation.depth_rays import HeightBand

types: Any = numba.types
READ_ONLY = np.zeros(3)
READ_ONLY.flags.writeable = False
ARGUMENTS = [
    1,
    1.5,
    True,
    np.float32(1.0),
    np.zeros((2, 3), np.uint16),
    np.zeros((2, 3)).T,
    np.zeros((4, 4))[::2, ::2],
    READ_ONLY,
    (1, 2),
    (1, 2.0),
    HeightBand(0.5, 0.1, 0.0, 1.0, 0.4, 4.0),
]


@pytest.mark.parametrize("argument", ARGUMENTS, ids=repr)
def test_the_type_of_an_argument_is_read_as_it_was_written(argument: object) -> None:
    wanted = numba.typeof(argument)  # type: ignore[no-untyped-call]
    assert from_json(json.loads(json.dumps(to_json(wanted)))) == wanted


@pytest.mark.parametrize("value", [3, True])
def test_a_number_that_is_known_at_compilation_keeps_its_value(value: int | bool) -> None:
    wanted = types.literal(value)
    assert from_json(json.loads(json.dumps(to_json(wanted)))) == wanted


def test_a_type_without_a_form_in_json_is_refused() -> None:
    with pytest.raises(TypeError, match="unicode_type has no form"):
        to_json(types.unicode_type)
