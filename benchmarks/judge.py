"""The cases of `odometry judge`: recordings, perturbations, starts, steps, sensors and scenes."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from benchmarks.changed_recordings import make_perturbation
from benchmarks.hard_cases import SCENES, SLOW, evaluate_scene, read_scene
from benchmarks.harness import Json, ResultCache, Table, format_counts, median, median_figure
from benchmarks.other_sensors import show_robot
from benchmarks.rendered_sequences import render_all
from benchmarks.sensor_timing import tell_exactly, tell_nothing
from benchmarks.tracking import evaluate_accuracy, open_frames_with_truth, track
from benchmarks.virtual_sensors import SEEDS as SENSOR_SEEDS
from benchmarks.virtual_sensors import make_sensors
from drivers.calibration import UNKNOWN_TIMING
from drivers.camera import RgbdFrame
from drivers.core import InputError
from drivers.tum.folder import open_tum_folder
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.warm_up import run_warm_up_frames
from vo_service.types.odometry import NullStageTimer

PARTS = ("recordings", "sensors", "scenes")
# Those of the table in docs/ are not used to choose a parameter.
SEEDS = {
    "tuning": tuple(seed for seed in SENSOR_SEEDS if seed <= len(SENSOR_SEEDS) // 2),
    "table": tuple(seed for seed in SENSOR_SEEDS if seed > len(SENSOR_SEEDS) // 2),
}
PERTURBATIONS = (1, 2, 3, 4, 5)
# First frames of a recording, as shares of its length.
STARTS = (0.04, 0.08, 0.12)
STEPS = (3, 5, 10)
STEP_PERTURBATIONS = (0, 1, 2)
# Scenes that are also seen with a part of the robot in view.
ROBOT_SCENES = ("person", "wall", "wall-drive")
# Shorter recordings have no frames to leave out.
MIN_FRAMES_TO_STEP = 100


@dataclass(frozen=True)
class Case:
    """One run of a method.

    Attributes:
        group: Row of the table that has the median of its cases.
        folder: The recording.
        method: The method.
        is_told: Whether the method is told the timing of the recording; otherwise nothing.
        perturbation: Seed of the perturbation; 0 for none.
        first: First frame.
        step: Every so many-th frame is used.
        end: Frame after the last one; None for all.
        scene: Name of the hard scene, "" for a recording.
        shows_robot: Whether a part of the robot is in view.
    """

    group: str
    folder: Path
    method: str
    is_told: bool = False
    perturbation: int = 0
    first: int = 0
    step: int = 1
    end: int | None = None
    scene: str = ""
    shows_robot: bool = False

    @property
    def key(self) -> str:
        """Name of the result; it does not depend on where the recording is."""
        told = " told" if self.is_told else ""
        end = "" if self.end is None else f" to {self.end}"
        return (
            f"{self.group} {self.method}{told} perturbation {self.perturbation} "
            f"from {self.first} step {self.step}{end}"
        )

    def change(self, frames: Iterable[RgbdFrame]) -> Iterator[RgbdFrame]:
        """Yield the frames of the case."""
        perturb = make_perturbation(self.perturbation).apply if self.perturbation else None
        for frame in frames:
            if self.end is not None and frame.seq >= self.end:
                return
            if frame.seq < self.first or (frame.seq - self.first) % self.step:
                continue
            known = tell_exactly(frame) if self.is_told else tell_nothing(frame)
            if self.shows_robot:
                known = show_robot(known)
            yield perturb(known) if perturb else known


def recording_cases(folder: Path, methods: Sequence[str]) -> list[Case]:
    """All cases of a recording: perturbations, starts and steps; baselines run unchanged.

    Raises:
        InputError: The folder cannot be used.
    """
    opened = open_tum_folder(folder, None)
    count, name = len(opened.frames.pairs), folder.name
    has_timing = opened.calibration.timing_prior != UNKNOWN_TIMING
    judged, *baselines = methods
    cases = [Case(name, folder, method) for method in baselines]
    for is_told in (True, False) if has_timing else (False,):
        group = f"{name}, told" if is_told else name
        make = partial(Case, group, folder, judged, is_told)
        cases += [make(perturbation=seed) for seed in (0, *PERTURBATIONS)]
        cases += [make(first=max(1, round(share * count))) for share in STARTS]
    if count >= MIN_FRAMES_TO_STEP:
        cases += [
            Case(f"{name}, step {step}", folder, method, perturbation=seed, step=step)
            for step in STEPS
            for method in methods
            for seed in (STEP_PERTURBATIONS if method == judged else (0,))
        ]
    return cases


def sensor_cases(folders: Mapping[str, Path], methods: Sequence[str]) -> list[Case]:
    """The cases of virtual sensors: unchanged, and two perturbations."""
    return [
        Case(name, folder, method, perturbation=seed)
        for name, folder in folders.items()
        for method in methods
        for seed in (STEP_PERTURBATIONS if method == methods[0] else (0,))
    ]


def run_cases(
    cases: Sequence[Case],
    cache: ResultCache,
    processes: int,
    prepare: Callable[[], object] = partial(cv2.setNumThreads, 1),  # noqa: B008 (it has no state)
) -> dict[str, Json]:
    """Run the cases that have no result yet, in several processes; return all results by key.

    Args:
        cases: The cases.
        cache: Has their results.
        processes: Number of processes.
        prepare: Called in each process before it imports a method.
    """
    missing = [case for case in cases if case.key not in cache]
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=prepare) as pool:
        # One process compiles the kernels; the others load them.
        for method in {case.method for case in missing}:
            pool.submit(_warm_up, method).result()
        futures = {pool.submit(run_case, case): case for case in missing}
        for count, future in enumerate(as_completed(futures), 1):
            cache.get_or_run(futures[future].key, future.result)
            if sys.stderr.isatty():
                print(f"\r{count} of {len(missing)} runs", end="", file=sys.stderr)
    return {case.key: cache.get_or_run(case.key, dict) for case in cases}


def _warm_up(method: str) -> None:
    """Compile the kernels in this process: others would not know changed parameters."""
    run_warm_up_frames(partial(METHODS[method], MethodConfig(), NullStageTimer()))


def run_case(case: Case) -> Json:
    """Track the frames of a case; return its accuracy, lost frames and time."""
    with open_frames_with_truth(case.folder) as (all_frames, truth):
        tracked = track(case.method, case.change(all_frames))
    result = asdict(evaluate_accuracy(tracked, truth))
    if case.scene and case.scene != SLOW:
        result["gross"] = evaluate_scene(tracked, truth, read_scene(case.scene)).gross
    return result


COLUMNS = ("ATE:8.1mm", "largest:9.1mm", "RPE/1s:8.1mm", "lost:6", "sigma:7d", "CPU ms:8.1f")
JUDGE_TABLE = Table(38, "runs:6d", *COLUMNS, "/ ref:7.2f", "best other:22", "/ best:8.2f")


def format_judgement(
    cases: Sequence[Case],
    results: Mapping[str, Json],
    judged: str,
    reference: Mapping[str, Json] | None = None,
) -> str:
    """A row for each group: medians of the judged method, ratios to a reference and to the best.

    Args:
        cases: All cases.
        results: Result of each case by key.
        judged: The method.
        reference: Results of the same cases by another state of the code, if there are any.
    """
    lines = [JUDGE_TABLE.head]
    ratios = []
    for group in dict.fromkeys(case.group for case in cases):
        of_group = [case for case in cases if case.group == group]
        mine = [case.key for case in of_group if case.method == judged]
        if not mine:
            continue
        others = {c.method: results[c.key] for c in of_group if c.method != judged}
        ate_m = median_figure(results, mine, "ate_m")
        known = [key for key in mine if reference and key in reference]
        reference_m = median_figure(reference or {}, known, "ate_m") if known else None
        ratio = ate_m / reference_m if ate_m is not None and reference_m else None
        if ratio is not None:
            ratios.append(ratio)
        lines.append(_format_group(group, [results[key] for key in mine], ate_m, ratio, others))
    if ratios:
        mean = float(np.exp(np.mean(np.log(ratios))))
        lines.append(
            f"\n{len(ratios)} groups: geometric mean of ATE / reference {mean:.3f}, "
            f"largest {max(ratios):.2f}"
        )
    return "\n".join(lines)


def _format_group(
    group: str,
    runs: Sequence[Json],
    ate_m: float | None,
    ratio: float | None,
    others: Mapping[str, Json],
) -> str:
    largest_m = [run["ate_m"] for run in runs if run["ate_m"] is not None]
    rpe_m = [run["rpe_1s_m"] for run in runs if run["rpe_1s_m"] is not None]
    lost = [run["failed"] for run in runs]
    # A method that loses frames has the error of the easy ones only.
    fair = {n: r for n, r in others.items() if r["ate_m"] and r["failed"] <= median(lost)}
    best = min(fair, key=lambda name: float(fair[name]["ate_m"]), default=None)
    return JUDGE_TABLE.row(
        group,
        len(runs),
        ate_m,
        max(largest_m, default=None),
        median(rpe_m) if rpe_m else None,
        format_counts(lost),
        int(median([run["overconfident"] for run in runs])),
        median([run["cpu_ms"] for run in runs]),
        ratio,
        f"{best} {1e3 * fair[best]['ate_m']:.1f}" if best else None,
        ate_m / fair[best]["ate_m"] if best and ate_m is not None else None,
    )


def find_recordings(folder: Path) -> list[Path]:
    """Folders with frames and ground truth. Raises InputError if there are none."""
    found = sorted(path.parent for path in folder.glob("*/groundtruth.txt"))
    recordings = [path for path in found if (path / "depth.txt").is_file()]
    if not recordings:
        raise InputError(f"{folder}: has no recordings with groundtruth.txt; name another folder")
    return recordings


def make_cases(
    kept: Path,
    recordings: Path,
    parts: Sequence[str],
    seeds: str,
    methods: Sequence[str],
    processes: int,
    only: Sequence[str] = (),
) -> list[Case]:
    """Make the cases of some parts; virtual sensors and scenes are rendered if they are missing.

    Args:
        kept: Folder for what is rendered.
        recordings: Folder of recordings.
        parts: Some of `PARTS`.
        seeds: Key of `SEEDS`.
        methods: The judged method, then those to compare it with.
        processes: Rendering processes.
        only: Recordings, sensors and scenes; all if empty.

    Raises:
        InputError: There are no recordings.
    """
    cases: list[Case] = []
    if "recordings" in parts:
        for folder in find_recordings(recordings):
            if not only or folder.name in only:
                cases += recording_cases(folder, methods)
    if "sensors" in parts:
        drawn = make_sensors(SEEDS[seeds]).items()
        chosen = {name: sensor for name, sensor in drawn if not only or name in only}
        cases += sensor_cases(render_all(kept / "sensors", chosen, processes), methods)
    if "scenes" in parts:
        names = [name for name in SCENES if name != SLOW and (not only or name in only)]
        configs = {name: read_scene(name) for name in names}
        scenes = render_all(kept, configs, processes)
        cases += [Case(name, path, methods[0], scene=name) for name, path in scenes.items()]
        cases += [
            Case(f"{name}, robot in view", path, methods[0], scene=name, shows_robot=True)
            for name, path in scenes.items()
            if name in ROBOT_SCENES
        ]
    return cases


def read_reference(file: Path) -> dict[str, Json]:
    """Read the results of another state of the code. Raises InputError if it cannot."""
    try:
        results: dict[str, Json] = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"--reference {file}: cannot read it ({error})") from error
    return results
