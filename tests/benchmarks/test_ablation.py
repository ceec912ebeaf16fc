"""The ablation of the direct method: parameters are changed in processes of a variant only."""

from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import pytest

from benchmarks.ablation import (
    ABLATIONS,
    UNCHANGED,
    change_parameters,
    check_changes,
    describe_changes,
    format_ablation,
    load_parameters,
    parse_changes,
)
from benchmarks.harness import Json
from drivers.core import InputError
from vo_service.odometry.direct import parameters


def compute_weight() -> float:
    """Weight of a residual of 2 with variance 1, by the compiled method of this process."""
    from vo_service.odometry.direct.factor import student_weight

    return student_weight(2.0, 1.0)


def run_of(ate_m: float | None, failed: int = 0) -> Json:
    return {"ate_m": ate_m, "failed": failed}


@pytest.mark.parametrize("name", ABLATIONS)
def test_each_variant_changes_parameters_that_exist(name: str) -> None:
    known = vars(load_parameters())
    assert all(known[each] != value for each, value in check_changes(ABLATIONS[name]).items())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["MAX_SPEED=1"], "parameter 'MAX_SPEED' is unknown"),
        (["MAX_KEYFRAMES=1.5"], "MAX_KEYFRAMES=1.5: must be of the kind of 30"),
        (["MAX_STEPS=1"], "MAX_STEPS=1: must be of the kind of"),
        (["MAX_KEYFRAMES"], "must be NAME=NUMBER"),
    ],
)
def test_a_wrong_change_is_one_line(words: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        check_changes(parse_changes(words))
    assert "\n" not in str(error.value)


def test_a_whole_number_becomes_one_of_the_parameters_type() -> None:
    changes = check_changes(parse_changes(["DEGREES_OF_FREEDOM=5", "MAX_STEPS=(9, 9)"]))
    assert describe_changes(changes) == "DEGREES_OF_FREEDOM=5.0 MAX_STEPS=(9,9)"


@pytest.mark.subprocess
def test_a_changed_parameter_is_compiled_into_the_method_of_a_new_process(tmp_path: Path) -> None:
    changes = check_changes({"DEGREES_OF_FREEDOM": 30})
    with ProcessPoolExecutor(
        1, get_context("spawn"), initializer=partial(change_parameters, changes, tmp_path)
    ) as pool:
        assert pool.submit(compute_weight).result() == 31 / 34
    assert compute_weight() == 4 / 7
    assert parameters.DEGREES_OF_FREEDOM == 3.0


def test_parameters_of_a_process_that_has_the_method_cannot_be_changed(tmp_path: Path) -> None:
    compute_weight()
    with pytest.raises(RuntimeError, match="cannot be changed after"):
        change_parameters({"DEGREES_OF_FREEDOM": 30.0}, tmp_path)


def test_a_row_has_medians_relative_to_the_unchanged_method_and_a_star_beyond_its_noise() -> None:
    keys = ["a", "b", "c"]
    unchanged = dict(zip(keys, map(run_of, (9e-3, 10e-3, 12e-3)), strict=True))
    worse = dict(zip(keys, map(run_of, (10e-3, 13e-3, 14e-3), (0, 2, 5)), strict=True))
    lines = format_ablation({"room": keys}, {UNCHANGED: unchanged, "worse": worse}).splitlines()
    assert lines[1] == "room"
    assert lines[2].split() == ["as", "it", "is", "3", "10.00", "-", "0.90-1.20", "0"]
    assert lines[3].split() == ["worse", "3", "13.00", "1.30*", "2-5"]


def test_a_variant_that_gives_no_trajectory_has_no_ratio() -> None:
    results = {UNCHANGED: {"a": run_of(1e-3)}, "blind": {"a": run_of(None, failed=9)}}
    assert format_ablation({"room": ["a"]}, results).split()[-5:] == ["blind", "1", "-", "-", "9"]
