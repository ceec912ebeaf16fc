"""``kinect-vo bench``: our methods beside other people's, how far off and at what cost."""

import argparse
import json
import tempfile
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

from drivers.errors import InputError
from vo_service.bench.contestants import NAMES, LeftOut, find_left_out, recipes_of
from vo_service.bench.report import SetUp, content_of, write_report
from vo_service.bench.tables import Ranking
from vo_service.commands.options import add_runs_options, config_of, count
from vo_service.folders import make_output_folder
from vo_service.interrupts import Stop, stop_on_signals
from vo_service.runs.campaign import Plan, run_all
from vo_service.runs.excerpt import Excerpt
from vo_service.runs.listening import NOBODY, LoopsRecipe
from vo_service.runs.results import collect
from vo_service.runs.run import RunState
from vo_service.runs.sequence import open_recordings
from vo_service.terminal import Terminal

NAME = "bench"
HELP = "our methods and other people's on recordings: accuracy, gross errors, time, memory"
EPILOG = f"""\
{textwrap.fill("methods: " + ", ".join(NAMES), 98, break_on_hyphens=False)}

examples:
  kinect-vo bench recordings/desk recordings/kitchen
  kinect-vo bench recordings/* --every 1 5 10 --output output/bench
  kinect-vo bench recordings/desk --frames 200 --methods surf icp cv2-rgb-depth --against surf

Each method runs over each folder (TUM format, as for replay) in a process of its own, on one
processor, one after another; reading images is not counted. What each column means is in
docs/bench.md. Methods of packages that are not installed are left out, with a note that says how
to install them.

With --loops, each trajectory is also corrected by the places that are seen again in it: columns say
how good it is then. The methods themselves are told nothing of places, also after a loss (where
replay --loops finds back): all their own figures but the memory stay as they are.

With --output, the folder gets report.json, bench.csv, the effective config.toml, and in runs/ what
each run did: given again, the same command goes on where it was stopped.

exit codes: 0 all runs came to their end; 1 one did not (the table says so); 2 something given is
wrong; 130 or 143 stopped, with a report of what was done until then.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--methods", metavar="METHOD", nargs="+", choices=NAMES, default=list(NAMES),
        help="which, in this order (default: all)",
    )  # fmt: skip
    parser.add_argument(
        "--every", metavar="N", nargs="+", type=count, default=[1],
        help="use one frame in N only; several for several rates (default: 1, every frame)",
    )  # fmt: skip
    parser.add_argument(
        "--frames", metavar="N", type=count, help="the first N frames of each recording alone"
    )
    parser.add_argument(
        "--against", metavar="METHOD", choices=NAMES,
        help="the method whose figures the others are divided by (default: the first)",
    )  # fmt: skip
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, help="where a report goes, and runs are kept"
    )
    add_runs_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run, tell each recording's results as soon as they are there, and report."""
    config = config_of(args)
    names = list(dict.fromkeys(args.methods))
    left_out = find_left_out(names)
    recipes = recipes_of(names, left_out, config.odometry)
    set_up = SetUp(
        methods=list(recipes),
        left_out=left_out,
        against=_against(args.against, list(recipes), left_out),
        every=list(dict.fromkeys(args.every)),
        frames=args.frames,
        odometry=config.odometry,
        camera_file=args.camera or config.camera.file,
        time_limit_s=args.time_limit,
        listener=LoopsRecipe(config.map) if args.loops else NOBODY,
    )
    recordings = [
        whole.only(Excerpt(every, args.frames))
        for whole in open_recordings(args.folders, set_up.camera_file)
        for every in set_up.every
    ]
    with _folder(args.output) as folder, stop_on_signals() as stop:
        runs = folder / "runs"
        plan = Plan(recordings, recipes, runs, args.time_limit, args.again, set_up.listener)
        rankings = []
        for ranking in _rankings(plan, set_up.against, stop):
            rankings.append(ranking)
            if not args.json:
                _print(ranking)
        write_report(folder, set_up, rankings)
    _print_end(args, set_up, rankings)
    all_done = all(judged.is_done for each in rankings for judged in each.result.judged.values())
    return stop.exit_code or (0 if all_done else 1)


def _against(asked: str | None, methods: Sequence[str], left_out: Sequence[LeftOut]) -> str:
    """The method that the others are divided by. Raises InputError if it does not take part."""
    if asked is None or asked in methods:
        return asked or methods[0]
    missing = next((str(each) for each in left_out if asked in each.methods), "")
    why = missing or f"it is not among --methods; name one of {', '.join(methods)}"
    raise InputError(f"--against {asked}: {why}")


@contextmanager
def _folder(output: Path | None) -> Iterator[Path]:
    """The folder of the report; without --output one that goes with the command."""
    if output is not None:
        make_output_folder(output)
        yield output
        return
    with tempfile.TemporaryDirectory(prefix="kinect-vo-bench-") as folder:
        yield Path(folder)


def _rankings(plan: Plan, against: str, stop: Stop) -> Iterator[Ranking]:
    """The results, recording by recording."""
    entries = run_all(plan, Terminal(), stop.event)
    for _, group in groupby(entries, key=lambda entry: entry.recording.name):
        (result,) = collect(group)
        yield Ranking(result, against)


def _print(ranking: Ranking) -> None:
    """The two tables, unless the bench was stopped before them."""
    states = {judged.outcome.state for judged in ranking.result.judged.values()}
    if states == {RunState.NOT_RUN}:
        return
    print(ranking.error_table().as_text())
    print(f"{ranking.cost_table().as_text()}\n", flush=True)


def _print_end(args: argparse.Namespace, set_up: SetUp, rankings: Sequence[Ranking]) -> None:
    if args.json:
        print(json.dumps(content_of(set_up, rankings)))
        return
    for each in set_up.left_out:
        print(each)
    if args.output is not None:
        print(f"report: {args.output}")
