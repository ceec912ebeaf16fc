"""The odometry: its accuracy, an ablation, and CPU time by stage, with other features, of SURF.

Each FOLDER is a TUM folder. Times are CPU milliseconds of one thread, without decoding.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from benchmarks import judge as judge_cases
from benchmarks.ablation import (
    ABLATIONS,
    UNCHANGED,
    change_parameters,
    check_changes,
    describe_changes,
    format_ablation,
    parse_changes,
)
from benchmarks.features import Gray, read_gray
from benchmarks.harness import (
    FOLDERS,
    PROCESSES,
    ResultCache,
    Table,
    Variants,
    measure_cpu_ms,
    median,
    option,
)
from benchmarks.tracking import (
    METHOD,
    TrackedSequence,
    evaluate_poses,
    open_frames,
    track_with,
)
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.tum.folder import read_frame_pairs
from vo_service.odom_frame import OdomFrame
from vo_service.odometry.features.descriptor import (
    DESCRIPTOR_SIZE,
    build_pyramid,
    describe,
    make_templates,
)
from vo_service.odometry.features.detector import find_maxima
from vo_service.odometry.features.extractor import LAYERS, NEXT_THRESHOLD_RATIO, SurfExtractor
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.stage_timers import STAGE_BUDGETS_MS, CpuStageTimer
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.odometry.warm_up import warm_up
from vo_service.tools.compare.baselines.frame_to_frame import (
    MATCH_RATIO,
    orb_odometry,
    sift_odometry,
)
from vo_service.tools.evaluation.evaluation import Evaluation
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import DeferredWork, StageTimer

UNTIL_POSE, WHOLE_FRAME = "until pose", "whole frame"
BUDGET_TABLE = Table(
    *(12, "frames:8d", "median:8.2f", "99 %:8.2f", "most:8.2f", "mean:8.2f", "budget:8.1f"),
    "share:8.0%",
)
FEATURE_METHODS = ("SURF", "SIFT", "ORB")
FEATURE_COUNT = 1000
FEATURE_STAGES = ("surf", "points", "match", "ransac", "svd", "verify")
FEATURE_TABLE = Table(
    *(10, "frames:8d", "failed:8d", "inliers:9.0f", "ATE:7.1mm", "global:8.1mm"),
    *("RPE/frame:11.1mm", "RPE/1s:8.1mm", "cover %:9.1f"),
    *(f"{stage}:8.2f" for stage in (*FEATURE_STAGES, "CPU ms")),
)
SURF_ROUNDS = 5


@dataclass(frozen=True)
class StageTiming:
    """Processor time of a stage, in milliseconds.

    `frames` is the number of frames in which the stage ran; the median, the 99th percentile and the
    maximum are over these. `mean` is over all frames. `budget` is for the mean; None if there is
    none.
    """

    frames: int
    median: float
    p99: float
    max: float
    mean: float
    budget: float | None

    @classmethod
    def from_samples(
        cls, spent_ms: Sequence[float], frames: int, budget_ms: float | None
    ) -> "StageTiming":
        """Summarize the times of a stage in the frames in which it ran."""
        median_ms, p99_ms = (float(p) for p in np.percentile(spent_ms, (50, 99)))
        mean_ms = sum(spent_ms) / frames
        return cls(len(spent_ms), median_ms, p99_ms, max(spent_ms), mean_ms, budget_ms)

    @property
    def is_over(self) -> bool:
        """Whether the mean exceeds the budget."""
        return self.budget is not None and self.mean > self.budget

    def format_row(self, stage: str) -> str:
        """The line of the table."""
        share = None if self.budget is None else self.mean / self.budget
        times = (self.median, self.p99, self.max, self.mean, self.budget, share)
        return BUDGET_TABLE.row(stage, self.frames, *times) + "  OVER" * self.is_over


@FOLDERS
@METHOD
def measure_budget(args: argparse.Namespace) -> int:
    """CPU time of each stage of a method, compared with its budget.

    "until pose" is without what the service does after it has published the pose. "mean" is over
    all frames: the means of stages add up to the cost of a frame, and the budget is for them.
    The other figures are over the frames in which the stage ran. Exit code 1 if a mean exceeds its
    budget.
    """
    warm_up(args.method, lambda stage: None)
    is_over = False
    for folder in args.folder:
        timer = CpuStageTimer()
        with open_frames(folder) as (frames, _):
            tracked = track_with(PoseFirst(args.method, timer), timer, frames, OdomFrame())
        stages = compare_with_budget(args.method, _with_whole_frame(tracked))
        print(folder, BUDGET_TABLE.head.replace(" " * 12, f"{'stage':12}", 1), sep="\n")
        print(*(spent.format_row(stage) for stage, spent in stages.items()), "", sep="\n")
        is_over |= any(spent.is_over for spent in stages.values())
    return int(is_over)


class PoseFirst:
    """Runs a method as the service does: what can wait is done after the estimate."""

    def __init__(self, method: str, timer: StageTimer) -> None:
        self._timer, self._deferred = timer, DeferredWork()
        self._odometry = METHODS[method](MethodConfig(deferred=self._deferred), timer)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose as `Odometry`, and time it."""
        with self._timer.stage(UNTIL_POSE):
            estimate = self._odometry.estimate(frame)
        self._deferred.run()
        return estimate


def _with_whole_frame(tracked: TrackedSequence) -> list[dict[str, float]]:
    """Milliseconds by stage of each frame, including `WHOLE_FRAME`."""
    return [
        {**stage_ms, WHOLE_FRAME: float(whole_ms)}
        for stage_ms, whole_ms in zip(tracked.stage_ms, tracked.cpu_ms, strict=True)
    ]


def compare_with_budget(
    method: str, times_ms: Sequence[Mapping[str, float]]
) -> dict[str, StageTiming]:
    """Summarize milliseconds by stage of frames: stages with a budget first, the whole frame last.

    Args:
        method: The method.
        times_ms: Milliseconds by stage of each frame.
    """
    budget_ms = STAGE_BUDGETS_MS.get(method, {})
    ran = {stage: None for of_frame in times_ms for stage in of_frame}
    stages = [*budget_ms, *(s for s in ran if s not in budget_ms and s != WHOLE_FRAME), WHOLE_FRAME]
    limits_ms = {**budget_ms, WHOLE_FRAME: sum(budget_ms.values()) or None}
    spent_ms = {stage: [t[stage] for t in times_ms if stage in t] for stage in stages}
    return {
        stage: StageTiming.from_samples(spent, len(times_ms), limits_ms.get(stage))
        for stage, spent in spent_ms.items()
        if spent
    }


def make_odometry(method: str, stopwatch: StageTimer) -> SurfOdometry:
    """Make the service's `surf` with the features of one of FEATURE_METHODS."""
    if method == "SIFT":
        return sift_odometry(FEATURE_COUNT, stopwatch)
    if method == "ORB":
        return orb_odometry(FEATURE_COUNT, stopwatch)
    parameters = SurfParameters(match_ratio=MATCH_RATIO)
    return SurfOdometry(SurfExtractor(FEATURE_COUNT), parameters, timer=stopwatch)


@dataclass(frozen=True)
class FeatureResult:
    """Result of the odometry with one kind of features on one folder.

    Attributes:
        frames: Number of frames.
        failed: Frames without a pose.
        inliers: Median over the frames with a pose.
        stage_ms: Median CPU time by stage, and of the whole frame.
        evaluation: None without ground truth.
    """

    frames: int
    failed: int
    inliers: float
    stage_ms: Mapping[str, float]
    evaluation: Evaluation | None

    @property
    def cells(self) -> list[float | None]:
        """The columns of the table."""
        e = self.evaluation
        errors: list[float | None] = [None] * 5
        if e is not None:
            percent = None if e.coverage is None else 100 * e.coverage
            errors = [e.ate_rmse_m, e.mean_global_error_m, e.rpe_frame_m, e.rpe_1s_m, percent]
        return [self.frames, self.failed, self.inliers, *errors, *self.stage_ms.values()]


@FOLDERS
@option("--methods", nargs="+", choices=FEATURE_METHODS, default=list(FEATURE_METHODS))
def measure_features(args: argparse.Namespace) -> None:
    """SURF compared with SIFT and ORB in the same odometry: errors and cost.

    Only the features differ: points, matching, RANSAC and SVD are those of the service. Times are
    medians over the frames. Distances are in millimeters; `kinect-vo evaluate` explains the
    figures.
    """
    for folder in args.folder:
        print(f"{folder}\n{FEATURE_TABLE.head}")
        for name in args.methods:
            print(FEATURE_TABLE.row(name, *measure_method(name, folder).cells), flush=True)
        print()


def measure_method(method: str, folder: Path) -> FeatureResult:
    """Run the odometry with one kind of features on all frames of a folder."""
    timer = CpuStageTimer()
    with open_frames(folder) as (frames, truth):
        tracked = track_with(make_odometry(method, timer), timer, frames, OdomFrame())
    stages_ms = _with_whole_frame(tracked)
    return FeatureResult(
        frames=len(tracked.estimates),
        failed=sum(not e.ok for e in tracked.estimates),
        inliers=median([e.inliers for e in tracked.estimates if e.ok]),
        stage_ms={
            stage: median([each[stage] for each in stages_ms if stage in each])
            for stage in (*FEATURE_STAGES, WHOLE_FRAME)
        },
        evaluation=evaluate_poses(tracked.trajectory, truth, tracked.stamps_s),
    )


@FOLDERS
@option("--frames", type=int, default=50, help="frames of each folder (50)")
@option("--count", type=int, default=FEATURE_COUNT, help="features of a frame (1000)")
def measure_surf(args: argparse.Namespace) -> None:
    """CPU time of each stage of SURF: layers, selection, image pyramid, descriptors.

    The first frames of each folder are used: for each frame the median of five rounds, and of these
    the median. A layer is named by the lobe of its filter, and has the search for its maxima.
    "whole" is the extraction as one call.
    """
    results = []
    for folder in args.folder:
        pairs = read_frame_pairs(folder).pairs[: max(args.frames, 1)]
        results.append(measure_images([read_gray(pair.color.file) for pair in pairs], args.count))
    table = Table(24, *(f"{folder.name}:{len(folder.name) + 2}.2f" for folder in args.folder))
    print(table.head)
    for stage in results[0]:
        print(table.row(stage, *(ms[stage] for ms in results)))


def measure_images(images: Sequence[Gray], count: int) -> dict[str, float]:
    """Milliseconds by stage: medians over the images."""
    extractor = SurfExtractor(count)
    extractor.extract(images[0])  # compiles
    of_images = [_measure_in_turn(_surf_stages(extractor, image)) for image in images]
    return {stage: median([ms[stage] for ms in of_images]) for stage in of_images[0]}


def _surf_stages(extractor: SurfExtractor, image: Gray) -> dict[str, Callable[[], object]]:
    """The stages for one image; the threshold is that of an equal image before."""
    weakest = extractor.extract(image).response.min(initial=np.inf)
    threshold = np.float32(NEXT_THRESHOLD_RATIO * weakest)
    integral = np.empty((image.shape[0] + 1, image.shape[1] + 1), np.int32)
    keypoints = extractor.detect(image)
    strongest = extractor.select_strongest(keypoints)
    pyramid, templates = build_pyramid(image), make_templates()
    directions = np.empty((len(strongest), 2), np.float32)
    descriptors = np.empty((len(strongest), DESCRIPTOR_SIZE), np.float32)
    return {
        "integral image": partial(cv2.integral, image, integral),
        **{
            f"lobe {layer.lobes[1]}, every {layer.step} px": partial(
                find_maxima, integral, layer, threshold
            )
            for layer in LAYERS
        },
        "selection": lambda: extractor.select_strongest(keypoints),
        "image pyramid": partial(build_pyramid, image, pyramid.packed),
        "descriptors": lambda: describe(
            pyramid, strongest, False, templates, directions, descriptors
        ),
        "whole": lambda: extractor.extract(image),
    }


def _measure_in_turn(stages: Mapping[str, Callable[[], object]]) -> dict[str, float]:
    """Median milliseconds of each stage over the rounds; a round runs all of them."""
    rounds = [
        {stage: measure_cpu_ms(run)[1] for stage, run in stages.items()} for _ in range(SURF_ROUNDS)
    ]
    return {stage: median([spent_ms[stage] for spent_ms in rounds]) for stage in stages}


@option("kept", metavar="KEPT", type=Path, help="folder of rendered and results")
@option(
    "recordings",
    metavar="RECORDINGS",
    type=Path,
    help="folder of TUM folders with ground truth",
)
@option("--parts", nargs="+", choices=judge_cases.PARTS, default=judge_cases.PARTS)
@option("--only", nargs="+", metavar="NAME", help="recordings, sensors and scenes")
@option(
    "--seeds",
    choices=judge_cases.SEEDS,
    default="tuning",
    help="seeds of the virtual sensors: tuning (default), or those for the table in docs/",
)
@option("--methods", nargs="+", choices=METHODS, default=("direct", "surf", "icp"))
@option("--reference", type=Path, metavar="FILE", help="results.json to compare")
@PROCESSES
def judge(args: argparse.Namespace) -> None:
    """Accuracy of a method over all recordings, perturbations, starts, steps, sensors and scenes.

    The first of --methods is judged, the others are run once for comparison. A row has the median
    of its runs: ATE, the largest ATE, RPE over a second (all in mm), lost frames (median, largest),
    poses that are wrong by more than three published sigmas, CPU time; ATE relative to --reference,
    and to the best other method that loses no more frames. Nothing is told but in rows "told".

    Virtual sensors and scenes are rendered into KEPT the first time, about half an hour of two
    cores. Finished runs are stored in KEPT/results.json; remove it when the odometry has changed.
    """
    reference = judge_cases.read_reference(args.reference) if args.reference else {}
    cases = judge_cases.make_cases(
        args.kept,
        args.recordings,
        args.parts,
        args.seeds,
        args.methods,
        args.processes,
        args.only or (),
    )
    results = judge_cases.run_cases(cases, ResultCache(args.kept), args.processes)
    print(judge_cases.format_judgement(cases, results, args.methods[0], reference))


@option("kept", metavar="KEPT", type=Path, help="folder of rendered and results")
@option("folder", metavar="RECORDINGS", type=Path, help="folder of TUM folders with ground truth")
@option("--only", nargs="+", choices=ABLATIONS, metavar="VARIANT", help=", ".join(ABLATIONS))
@option(
    "--set",
    nargs="+",
    action="append",
    default=[],
    metavar="NAME=VALUE",
    help="a variant of your own; may be given several times; alone, only these run",
)
@option("--parts", nargs="+", choices=judge_cases.PARTS, default=("recordings",), help="of `judge`")
@option("--recordings", nargs="+", metavar="NAME", help="recordings and scenes")
@option("--frames", type=int, metavar="N", help="only N frames of each run")
@PROCESSES
def ablate(args: argparse.Namespace) -> None:
    """Accuracy of `direct` with parts switched off and with other parameters.

    The runs are those of `judge` at full rate. A row has the median of its runs: ATE (mm), the same
    relative to the unchanged method, and lost frames (median, largest). "noise" is the range of the
    unchanged method's own runs relative to their median; a ratio outside of it has a star.

    A variant compiles the method for itself, which takes about a minute. Finished runs are stored
    in KEPT; remove it when the odometry has changed.
    """
    names = args.only or ([] if args.set else ABLATIONS)
    variants = {name: check_changes(ABLATIONS[name]) for name in names}
    for changes in map(check_changes, map(parse_changes, args.set)):
        variants[describe_changes(changes)] = changes
    cases = judge_cases.make_cases(
        args.kept, args.folder, args.parts, "tuning", ("direct",), args.processes
    )
    cases = [
        replace(case, end=args.frames and case.first + args.frames)
        for case in cases
        if case.step == 1 and (not args.recordings or case.folder.name in args.recordings)
    ]
    if not cases:
        raise InputError(f"{args.folder}: has none of {', '.join(args.recordings or args.parts)}")
    results = {UNCHANGED: judge_cases.run_cases(cases, ResultCache(args.kept), args.processes)}
    for name, changes in variants.items():
        cache = ResultCache(args.kept / "ablation" / describe_changes(changes))
        with TemporaryDirectory() as kernels:
            prepare = partial(change_parameters, changes, Path(kernels))
            results[name] = judge_cases.run_cases(cases, cache, args.processes, prepare)
    groups: dict[str, list[str]] = {}
    for case in cases:
        groups.setdefault(case.group, []).append(case.key)
    print(format_ablation(groups, results))


VARIANTS: Variants = {
    "judge": judge,
    "ablation": ablate,
    "budget": measure_budget,
    "features": measure_features,
    "surf": measure_surf,
}
