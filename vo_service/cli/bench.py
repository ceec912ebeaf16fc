"""``kinect-vo bench``: compare accuracy and cost of our methods and of other packages."""

import argparse
import json
import sys
import tempfile
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

from drivers.core import InputError
from drivers.core.files import create_output_folder
from vo_service.cli.options import add_benchmark_options, load_config, parse_count, requested_topics
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.benchmark import RunState
from vo_service.tools.benchmark.baselines import ORB_SLAM3
from vo_service.tools.benchmark.baselines.orb_vocabulary import read_vocabulary_file
from vo_service.tools.benchmark.batch import BatchPlan, run_batch
from vo_service.tools.benchmark.methods import (
    METHOD_NAMES,
    UnavailableMethods,
    find_unavailable_methods,
    make_method_factories,
)
from vo_service.tools.benchmark.observers import NULL_OBSERVER, LoopClosureObserverFactory
from vo_service.tools.benchmark.recordings import FrameSelection, open_recordings
from vo_service.tools.benchmark.report.bench_report import (
    BenchMetadata,
    RelativeResults,
    report_content,
    write_bench_report,
)
from vo_service.tools.benchmark.results import collect_results

EPILOG = f"""\
{textwrap.fill("methods: " + ", ".join(METHOD_NAMES), 98, break_on_hyphens=False)}

examples:
  kinect-vo bench recordings/desk recordings/kitchen
  kinect-vo bench recordings/* --every 1 5 10 --output output/bench
  kinect-vo bench recordings/desk --frames 200 --methods surf icp cv2-rgb-depth --against surf

Each method runs over each folder (TUM format, as for replay) in a process of its own, on one
processor, one after another. Times do not include reading images. Methods of packages that are not
installed are skipped; a note says how to install them. docs/guide/comparing-methods.md explains the
columns.

ORB-SLAM3 needs a DBoW2 vocabulary. Without --orb-vocabulary a small one is trained from each
recording; a line below the tables says which was used.

--loop-closure also optimizes each trajectory by loop closure and adds columns for the result. The
methods do not use it, not even after a loss (unlike replay --loop-closure), so their own figures do
not change, except for the memory.

--output FOLDER receives report.json, bench.csv, the effective config.toml and runs/ with the result
of each run. The same command resumes where it was stopped.

exit codes: 0 all runs finished; 1 a run failed (see the table); 2 wrong input; 130 or 143 stopped,
with a report of the runs that finished.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--methods", metavar="METHOD", nargs="+", choices=METHOD_NAMES, default=list(METHOD_NAMES),
        help="methods to run, in this order (default: all)",
    )  # fmt: skip
    parser.add_argument(
        "--every", metavar="N", nargs="+", type=parse_count, default=[1],
        help="use every Nth frame; several values make several runs (default: 1)",
    )  # fmt: skip
    parser.add_argument(
        "--frames",
        metavar="N",
        type=parse_count,
        help="use only the first N frames of each recording",
    )
    parser.add_argument(
        "--against", metavar="METHOD", choices=METHOD_NAMES,
        help="baseline for relative figures (default: the first method)",
    )  # fmt: skip
    parser.add_argument(
        "--orb-vocabulary", metavar="FILE", type=Path,
        help="DBoW2 vocabulary of orb-slam3, as text (default: train one from each recording)",
    )  # fmt: skip
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, help="folder for the report and the cached runs"
    )
    add_benchmark_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the methods, print each recording's tables as they finish, and write the report.

    Raises:
        UserFacingError: If an option or a recording is not valid, or if the report cannot be
            written.
    """
    config = load_config(args)
    names = list(dict.fromkeys(args.methods))
    unavailable = find_unavailable_methods(names)
    vocabulary = read_vocabulary_file(args.orb_vocabulary) if args.orb_vocabulary else None
    factories = make_method_factories(names, unavailable, config.odometry, vocabulary)
    metadata = BenchMetadata(
        methods=list(factories),
        unavailable=unavailable,
        reference_method=_choose_reference_method(args.against, list(factories), unavailable),
        frame_steps=list(dict.fromkeys(args.every)),
        max_frames=args.frames,
        odometry=config.odometry,
        camera_file=args.camera_file or config.camera.file,
        time_limit_s=args.time_limit,
        observer_factory=LoopClosureObserverFactory(config.map)
        if args.loop_closure
        else NULL_OBSERVER,
        orb_vocabulary=str(factories[ORB_SLAM3].settings["vocabulary"])
        if ORB_SLAM3 in factories
        else "",
    )
    recordings = [
        whole.select(FrameSelection(every, args.frames))
        for whole in open_recordings(args.folders, metadata.camera_file, requested_topics(args))
        for every in metadata.frame_steps
    ]
    with _open_report_folder(args.output) as folder, stop_on_signals() as stop:
        runs = folder / "runs"
        plan = BatchPlan(
            recordings, factories, runs, args.time_limit, args.force, metadata.observer_factory
        )
        rankings = []
        for ranking in _run_methods(plan, metadata.reference_method, stop):
            rankings.append(ranking)
            if not args.json:
                _print_tables(ranking, metadata.orb_vocabulary)
        write_bench_report(folder, metadata, rankings)
    _print_summary(args, metadata, rankings)
    all_done = all(
        judged.is_done for each in rankings for judged in each.results.evaluations.values()
    )
    return stop.exit_code or (0 if all_done else 1)


def _choose_reference_method(
    requested: str | None, methods: Sequence[str], unavailable: Sequence[UnavailableMethods]
) -> str:
    """Choose the baseline for relative figures; raise InputError if it is not among the methods."""
    if requested is None or requested in methods:
        return requested or methods[0]
    missing = next((str(each) for each in unavailable if requested in each.methods), "")
    reason = missing or f"it is not among --methods; name one of {', '.join(methods)}"
    raise InputError(f"--against {requested}: {reason}")


@contextmanager
def _open_report_folder(output: Path | None) -> Iterator[Path]:
    """Open the folder of the report; without --output a temporary one."""
    if output is not None:
        create_output_folder(output)
        yield output
        return
    with tempfile.TemporaryDirectory(prefix="kinect-vo-bench-") as folder:
        yield Path(folder)


def _run_methods(
    plan: BatchPlan, reference_method: str, stop: StopSignal
) -> Iterator[RelativeResults]:
    """Yield the results of each recording."""
    entries = run_batch(plan, Terminal(), stop.event)
    for _, group in groupby(entries, key=lambda entry: entry.recording.name):
        (result,) = collect_results(group)
        yield RelativeResults(result, reference_method)


def _print_tables(results: RelativeResults, orb_vocabulary: str) -> None:
    """Print both tables and the vocabulary of ORB-SLAM3, unless no method has run."""
    states = {judged.outcome.state for judged in results.results.evaluations.values()}
    if states == {RunState.NOT_RUN}:
        return
    results.error_table().write(sys.stdout)
    results.cost_table().write(sys.stdout)
    if orb_vocabulary:
        print(f"{ORB_SLAM3}: vocabulary {orb_vocabulary}")
    print(flush=True)


def _print_summary(
    args: argparse.Namespace, metadata: BenchMetadata, results: Sequence[RelativeResults]
) -> None:
    if args.json:
        print(json.dumps(report_content(metadata, results)))
        return
    for each in metadata.unavailable:
        print(each)
    if args.output is not None:
        print(f"report: {args.output}")
