"""``kinect-vo compare``: compare methods on recordings, and write a report."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from drivers.core import InputError
from drivers.core.files import create_output_folder
from vo_service.cli.options import add_benchmark_options, load_config, requested_topics
from vo_service.config import Config
from vo_service.odometry import METHODS
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.benchmark.batch import BatchPlan, run_batch
from vo_service.tools.benchmark.methods import (
    ConfiguredMethodFactory,
    MethodFactory,
    SfmScale,
    TrueScaleSfmFactory,
)
from vo_service.tools.benchmark.observers import NULL_OBSERVER, LoopClosureObserverFactory
from vo_service.tools.benchmark.recordings import BenchmarkRecording, open_recordings
from vo_service.tools.benchmark.report import ComparisonMetadata
from vo_service.tools.benchmark.report.comparison_report import (
    ComparisonReport,
    write_comparison_report,
)
from vo_service.tools.benchmark.report.comparison_tables import (
    error_table,
    loop_closure_table,
    time_table,
)
from vo_service.tools.benchmark.results import SequenceResults, collect_results

EPILOG = """\
examples:
  kinect-vo compare recordings/desk recordings/kitchen
  kinect-vo compare rgbd_dataset_freiburg1_* --output output/freiburg1
  kinect-vo compare recordings/desk --methods surf --json | jq .sequences[0].methods.surf.ate_rmse_m

Each method runs over each folder (TUM format, as for replay) in a process of its own, one after
another. OUTPUT receives report.html, report.json, the tables as CSV, the figures as PNG and SVG,
the effective config.toml and runs/ with the result of each run. Finished runs are cached: the same
command resumes where it was stopped. They are re-run if the program, the settings, the computer or
the recording changes, or with --force.

--loop-closure adds a table of each trajectory after optimization by loop closure. The methods do
not use it, not even after a loss (unlike replay --loop-closure), so their own figures do not
change, except for the memory.

Without FOLDER/groundtruth.txt coverage, times and trajectories are reported, but no errors.

exit codes: 0 all runs finished; 1 a run failed (see the report); 2 wrong input; 130 or 143 stopped,
with a report of the runs that finished.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "--methods", metavar="METHOD", nargs="+", choices=list(METHODS), default=list(METHODS),
        help=f"methods to run, in this order (default: all: {', '.join(METHODS)})",
    )  # fmt: skip
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, default=Path("output/compare"),
        help="folder for the report and the cached runs (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--sfm-scale", choices=[str(scale) for scale in SfmScale], default=SfmScale.FIRST_DEPTH,
        help="source of the initial scale of sfm (default: %(default)s)",
    )  # fmt: skip
    add_benchmark_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the methods, write the report, and print its main tables.

    Raises:
        UserFacingError: If an option or a recording is not valid, or if the report cannot be
            written.
    """
    config = load_config(args)
    methods = list(dict.fromkeys(args.methods))
    camera_file = args.camera_file or config.camera.file
    scale = SfmScale(args.sfm_scale)
    observer = LoopClosureObserverFactory(config.map) if args.loop_closure else NULL_OBSERVER
    metadata = ComparisonMetadata(methods, config, scale, camera_file, args.time_limit, observer)
    recordings = open_recordings(args.folders, camera_file, requested_topics(args))
    factories = make_method_factories(config, methods, scale)
    _check_ground_truth(recordings, factories)
    runs = args.output / "runs"
    plan = BatchPlan(recordings, factories, runs, args.time_limit, args.force, observer)
    create_output_folder(args.output)
    terminal = Terminal()
    with stop_on_signals() as stop:
        results = collect_results(run_batch(plan, terminal, stop.event))
        report = write_comparison_report(args.output, results, metadata, terminal)
    _print(report, results, args.json)
    all_done = all(judged.is_done for result in results for judged in result.evaluations.values())
    return stop.exit_code or (0 if all_done else 1)


def make_method_factories(
    config: Config, methods: Sequence[str], scale: SfmScale
) -> Mapping[str, MethodFactory]:
    """Return the factory of each method by name.

    Args:
        config: Settings of the methods.
        methods: Names of the methods.
        scale: Source of the initial scale of sfm.
    """
    kinds = {"sfm": TrueScaleSfmFactory} if scale is SfmScale.GROUND_TRUTH else {}
    return {
        method: kinds.get(method, ConfiguredMethodFactory)(replace(config.odometry, method=method))
        for method in methods
    }


def _check_ground_truth(
    recordings: Sequence[BenchmarkRecording], factories: Mapping[str, MethodFactory]
) -> None:
    """Raise InputError if a method needs the ground truth and a recording has none."""
    missing = next((each for each in recordings if each.truth is None), None)
    if missing is not None and any(factory.uses_truth for factory in factories.values()):
        raise InputError(
            f"{missing.folder}: has no groundtruth.txt, which --sfm-scale ground-truth needs; "
            "leave the option out, or the folder"
        )


def _print(report: ComparisonReport, results: Sequence[SequenceResults], as_json: bool) -> None:
    if as_json:
        print(json.dumps(report.content))
        return
    tables = [error_table(results), time_table(results)]
    if results[0].has_loop_closure:
        tables.append(loop_closure_table(results))
    for table in tables:
        table.write(sys.stdout)
        print()
    print(f"report: {report.page}")
