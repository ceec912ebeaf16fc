"""Options that are made from the fields of a request and of the configuration."""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest

from drivers.camera import PlaybackMode
from vo_service.cli.options import at_pace
from vo_service.cli.request import (
    CommandRequest,
    add_options,
    argument,
    config_option,
    flag,
    make_request,
    option,
    with_options,
)
from vo_service.cli.run import RunServiceRequest
from vo_service.config import Config


@dataclass(frozen=True, kw_only=True)
class Example(CommandRequest):
    """Options of all kinds."""

    folder: Path = argument("a folder", "FOLDER")
    size: tuple[int, int] | None = option("two numbers", metavar=("W", "H"), minimum=1)
    output: Path | None = option("a file", metavar="FILE")
    names: tuple[str, ...] = option("names", (), "NAME", is_repeated=True)
    is_loud: bool = flag("more noise")
    voxel_m: Annotated[float | None, config_option("map.voxel_m", noun="a length")] = None


def parse(*words: str) -> Example:
    parser = argparse.ArgumentParser()
    add_options(parser, Example)
    return make_request(Example, parser.parse_args([*words], argparse.Namespace(verbose=False)))


def test_values_have_the_types_of_their_fields() -> None:
    words = ("--size", "4", "3", "--names", "a", "--names", "b", "--is-loud", "--voxel-m", "0.1")
    assert parse("desk", *words) == Example(
        folder=Path("desk"), size=(4, 3), names=("a", "b"), is_loud=True, voxel_m=0.1
    )


def test_an_option_has_the_limits_of_the_key_that_it_sets(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        parse("desk", "--voxel-m", "0.001")
    assert "0.001 is not a length: give 0.005 to 0.5" in capsys.readouterr().err


@pytest.mark.parametrize("words", [("",), ("desk", "--output", "")])
def test_an_empty_path_is_not_the_current_folder(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parse(*words)
    assert "is empty: give a path" in capsys.readouterr().err


def test_an_option_sets_its_key_only_if_it_is_given() -> None:
    assert with_options(parse("desk", "--voxel-m", "0.1"), Config()).map.voxel_m == 0.1
    assert with_options(parse("desk"), Config()) == Config()


def test_run_with_the_small_profile_has_no_flight_recorder() -> None:
    config = RunServiceRequest(profile="small").load()
    assert config.odometry.profile == "small"
    assert not config.has_recorder


@pytest.mark.parametrize(
    ("pace", "adapts"), [(PlaybackMode.LOCKSTEP, False), (PlaybackMode.REALTIME, True)]
)
def test_lockstep_sheds_no_load_and_waits_for_no_other_process(
    pace: PlaybackMode, adapts: bool
) -> None:
    config = at_pace(Config(), pace)
    assert (config.load.adapt, config.map.loop_closure) == (adapts, adapts)
