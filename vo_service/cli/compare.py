"""``kinect-vo compare``: compare methods on recordings, and write a report."""

import json
import logging
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.core import InputError
from drivers.core.write_errors import create_output_folder
from vo_service.cli.options import (
    CameraFile,
    ConfigFile,
    Topics,
    load_config,
    parse_count,
    parse_seconds,
)
from vo_service.cli.request import CommandRequest, argument, flag, option
from vo_service.config import Config, OdometryConfig
from vo_service.odometry.registry import METHODS
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.compare.baselines.orb_vocabulary import read_vocabulary_file
from vo_service.tools.compare.baselines.registry import ORB_SLAM3
from vo_service.tools.compare.batch import BatchPlan, run_batch
from vo_service.tools.compare.methods import (
    METHOD_NAMES,
    MethodFactory,
    SfmScale,
    UnavailableMethods,
    find_unavailable_methods,
    make_method_factories,
)
from vo_service.tools.compare.observers import NULL_OBSERVER, LoopClosureObserverFactory
from vo_service.tools.compare.recordings import BenchmarkRecording, FrameSelection, open_recordings
from vo_service.tools.compare.report.metadata import ReportMetadata
from vo_service.tools.compare.report.report_folder import PAGE_FILE, report_content, write_report
from vo_service.tools.compare.report.tables import cost_table, error_table
from vo_service.tools.compare.results import SequenceResults, evaluate_runs
from vo_service.tools.compare.run_outcome import RunState

ALL_METHODS = "all"

logger = logging.getLogger(__name__)

EPILOG = f"""\
{textwrap.fill("methods: " + ", ".join(METHOD_NAMES), 98, break_on_hyphens=False)}

examples:
  kinect-vo compare recordings/desk recordings/kitchen
  kinect-vo compare rgbd_dataset_freiburg1_* --output output/freiburg1
  kinect-vo compare recordings/* --methods all --every 1 5 10
  kinect-vo compare recordings/desk --frames 200 --methods surf cv2-rgb-depth --against surf
  kinect-vo compare recordings/desk --methods surf --json | jq .sequences[0].methods.surf.ate_rmse_m

Each method runs over each recording in a process of its own, on one processor, one after another.
Times do not include reading images. Methods of packages that are not installed are skipped; a note
says how to install them. docs/guide/comparing-methods.md explains the columns.

OUTPUT receives report.html, report.json, the tables as CSV, the figures as PNG and SVG, the
effective config.toml and runs/ with the result of each run. Finished runs are cached: the same
command resumes where it was stopped. They are re-run if the program, the settings, the computer or
the recording changes, or with --force.

ORB-SLAM3 needs a DBoW2 vocabulary. Without --orb-vocabulary a small one is trained from each
recording; a line below the tables says which was used.

--loop-closure also optimizes each trajectory by loop closure and adds columns for the result. The
methods do not use it, not even after a loss (unlike replay --loop-closure), so their own figures do
not change, except for the memory.

Without groundtruth.txt coverage, times and trajectories are reported, but no errors.

exit codes: 0 all runs finished; 1 a run failed (see the tables); 2 wrong input; 130 or 143 stopped,
with a report of the runs that finished.
"""


@dataclass(frozen=True, kw_only=True)
class ComparisonRequest(CommandRequest):
    """The recordings, the methods, and how to compare them."""

    folders: tuple[Path, ...] = argument(
        "recordings: folders in TUM format or other layouts, MCAP files or ROS bags", "RECORDING"
    )
    methods: tuple[str, ...] = option(
        "methods to run, in this order, or all, also those of other packages (default: "
        f"{' '.join(METHODS)})",
        tuple(METHODS),
        "METHOD",
        allowed=[*METHOD_NAMES, ALL_METHODS],
    )
    every: tuple[int, ...] = option(
        "use every Nth frame; several values make several runs (default: 1)", (1,), "N", parse_count
    )
    frames: int | None = option(
        "use only the first N frames of each recording", None, "N", parse_count
    )
    against: str | None = option(
        "also show figures relative to this one of the methods",
        metavar="METHOD",
        allowed=METHOD_NAMES,
    )
    output: Path = option(
        "folder for the report and the cached runs (default: %(default)s)",
        Path("output/compare"),
        "FOLDER",
    )
    sfm_scale: str = option(
        "source of the initial scale of sfm (default: %(default)s)",
        SfmScale.FIRST_DEPTH,
        allowed=[str(scale) for scale in SfmScale],
    )
    orb_vocabulary: Path | None = option(
        "DBoW2 vocabulary of orb-slam3, as text (default: train one from each recording)",
        metavar="FILE",
    )
    topics: Topics = None
    config: ConfigFile = None
    camera_file: CameraFile = None
    time_limit: float = option(
        "time limit of a run; a longer run is ended and reported (default: %(default)g)",
        3600.0,
        "SECONDS",
        parse_seconds,
    )
    loop_closure: bool = flag(
        "also optimize each trajectory by loop closure; the methods' own figures stay"
    )
    force: bool = flag("re-run cached results")
    json: bool = flag("print report.json, nothing else")

    @property
    def method_names(self) -> tuple[str, ...]:
        """The methods, each once."""
        return METHOD_NAMES if ALL_METHODS in self.methods else tuple(dict.fromkeys(self.methods))


def run(request: ComparisonRequest) -> int:
    """Run the methods, print each recording's tables as they finish, and write the report."""
    config = load_config(request.config, request)
    unavailable = find_unavailable_methods(request.method_names)
    factories = _make_factories(request, config.odometry, unavailable)
    metadata = _make_metadata(request, config, factories, unavailable)
    recordings = [
        whole.select(FrameSelection(every, request.frames))
        for whole in open_recordings(request.folders, metadata.camera_file, request.topics)
        for every in metadata.frame_steps
    ]
    _check_ground_truth(recordings, factories)
    create_output_folder(request.output)
    plan = BatchPlan(
        recordings,
        factories,
        request.output / "runs",
        request.time_limit,
        request.force,
        metadata.observer_factory,
    )
    terminal, results = Terminal(), []
    with stop_on_signals() as stop:
        for recording, outcomes in run_batch(plan, terminal, stop.event):
            result = evaluate_runs(recording, outcomes, request.against, request.loop_closure)
            results.append(result)
            if not request.json:
                _print_tables(result, metadata)
        write_report(request.output, metadata, results, terminal)
    if request.json:
        print(json.dumps(report_content(metadata, results)))
    else:
        print(*unavailable, f"report: {request.output / PAGE_FILE}", sep="\n")
    all_done = all(judged.is_done for result in results for judged in result.evaluations.values())
    has_motion = [_has_motion(result) for result in results]  # logs each that has none
    return stop.exit_code or (0 if all_done and all(has_motion) else 1)


def _make_factories(
    request: ComparisonRequest, odometry: OdometryConfig, unavailable: Sequence[UnavailableMethods]
) -> Mapping[str, MethodFactory]:
    """Make the methods; raise InputError if the vocabulary or the reference is not valid."""
    vocabulary = read_vocabulary_file(request.orb_vocabulary) if request.orb_vocabulary else None
    factories = make_method_factories(
        request.method_names, unavailable, odometry, SfmScale(request.sfm_scale), vocabulary
    )
    _check_reference_method(request.against, factories, unavailable)
    return factories


def _make_metadata(
    request: ComparisonRequest,
    config: Config,
    factories: Mapping[str, MethodFactory],
    unavailable: Sequence[UnavailableMethods],
) -> ReportMetadata:
    orb_slam = factories.get(ORB_SLAM3)
    closes_loops = request.loop_closure
    return ReportMetadata(
        methods=list(factories),
        odometry=config.odometry,
        time_limit_s=request.time_limit,
        unavailable=unavailable,
        reference_method=request.against,
        frame_steps=list(dict.fromkeys(request.every)),
        max_frames=request.frames,
        sfm_scale=SfmScale(request.sfm_scale),
        orb_vocabulary=str(orb_slam.settings["vocabulary"]) if orb_slam else None,
        camera_file=config.camera.file,
        observer_factory=LoopClosureObserverFactory(config.map) if closes_loops else NULL_OBSERVER,
    )


def _has_motion(result: SequenceResults) -> bool:
    """Log each run in which no frame has a pose; return whether there is none."""
    runs = {name: judged.outcome.run for name, judged in result.evaluations.items()}
    reasons = {name: run.no_motion_reason for name, run in runs.items() if run.no_motion_reason}
    for name, reason in reasons.items():
        logger.error("%s, %s: %s", result.recording.name, name, reason)
    return not reasons


def _check_reference_method(
    requested: str | None,
    factories: Mapping[str, MethodFactory],
    unavailable: Sequence[UnavailableMethods],
) -> None:
    """Raise InputError if the baseline for relative figures is not among the methods."""
    if requested is None or requested in factories:
        return
    missing = next((str(each) for each in unavailable if requested in each.methods), "")
    reason = missing or f"it is not among --methods; name one of {', '.join(factories)}"
    raise InputError(f"--against {requested}: {reason}")


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


def _print_tables(result: SequenceResults, metadata: ReportMetadata) -> None:
    """Print both tables and the vocabulary of ORB-SLAM3, unless no method has run."""
    states = {judged.outcome.state for judged in result.evaluations.values()}
    if states == {RunState.NOT_RUN}:
        return
    error_table(result).write(sys.stdout)
    cost_table(result).write(sys.stdout)
    if metadata.orb_vocabulary is not None:
        print(f"{ORB_SLAM3}: vocabulary {metadata.orb_vocabulary}")
    print(flush=True)
