"""Parameter sweep of the direct odometry: one changed constant at a time, on some recordings.

    python -m benchmarks direct_sweep KEPT FOLDER... --of NAME=VALUE [NAME=VALUE ...]
    python -m benchmarks direct_sweep KEPT FOLDER... --times 0.5 2

NAME is a constant of vo_service/odometry/direct/parameters.py, VALUE its other value, written as
there. --times multiplies every constant, or each of its parts, by a factor. FOLDER is a TUM folder
with ground truth, FOLDER@5 is every fifth frame of it. Each value runs in a separate process with
its own kernels, which compile for half a minute.

The first row has the current values. For each recording it has the ATE and, in brackets, the mean
global error in millimeters, then frames without a pose and gross errors if there are any. Finished
rows are stored in KEPT/results.json, and the same command continues with the next. Remove KEPT when
the odometry has changed.
"""

import argparse
import ast
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from benchmarks.harness import Json, ResultCache
from benchmarks.tracking import read_all_frames
from drivers.camera import PlaybackMode
from drivers.core import InputError
from drivers.core.geometry import Trajectory
from drivers.recording_camera import RecordingCamera
from vo_service import odometry
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.metrics import associate, count_gross_errors, tracked_steps

BASELINE = "as it is"


def _load_parameters() -> ModuleType:
    """Load the parameters before the odometry, whose kernels are compiled with their values."""
    path = Path(odometry.__file__).parent / "direct" / "parameters.py"
    spec = importlib.util.spec_from_file_location(f"{odometry.__name__}.direct.parameters", path)
    assert spec is not None
    assert spec.loader is not None
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


parameters = _load_parameters()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("kept", metavar="KEPT", type=Path, help="folder of stored rows")
    parser.add_argument(
        "recording", nargs="+", metavar="FOLDER", help="TUM folder, or FOLDER@EVERY"
    )
    parser.add_argument("--of", nargs="+", default=[], metavar="NAME=VALUE", help="other values")
    parser.add_argument("--times", nargs="+", type=float, default=[], metavar="FACTOR")


def main(args: argparse.Namespace) -> None:
    """Run every value without a stored row, and print all rows."""
    changes = [BASELINE, *args.of]
    for factor in args.times:
        changes += [
            change for name in swept_parameters() if (change := scale_parameter(name, factor))
        ]
    print(f"{'':38}" + "".join(f"{Path(folder).name:>30}" for folder in args.recording))
    args.kept.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(args.kept)
    for change in changes:
        cells = cache.get_or_run(change, partial(run_in_subprocess, change, args.recording))
        print(format_row(change, cells, args.recording), flush=True)


def swept_parameters() -> list[str]:
    """Names of all constants, in the order of the file."""
    return [name for name in vars(parameters) if name.isupper()]


def scale_parameter(name: str, factor: float) -> str:
    """NAME=VALUE with the constant multiplied by `factor`; "" if that does not change it."""
    value = getattr(parameters, name)
    parts = value if isinstance(value, tuple) else (value,)
    changed = tuple(
        max(1, round(part * factor)) if isinstance(part, int) else float(f"{part * factor:.6g}")
        for part in parts
    )
    return "" if changed == parts else f"{name}={changed if len(changed) > 1 else changed[0]}"


def run_in_subprocess(change: str, recordings: Sequence[str]) -> Json:
    """Compute the cells of one row; after a failure its reason under "failed"."""
    with tempfile.TemporaryDirectory() as cache:
        result = subprocess.run(
            [sys.executable, "-m", "benchmarks.direct_sweep", change, *recordings],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
        )
    if result.returncode != 0:
        return {"failed": result.stderr.strip().splitlines()[-1]}
    cells: Json = json.loads(result.stdout)
    return cells


def parse_change(change: str) -> tuple[str, object]:
    """Parse NAME=VALUE."""
    name, _, value = change.partition("=")
    return name, ast.literal_eval(value)


def format_row(change: str, cells: Json, recordings: Sequence[str]) -> str:
    """One row of the table.

    Args:
        change: The change, "NAME=VALUE".
        cells: Results by recording, or the failure.
        recordings: The columns.
    """
    if "failed" in cells:
        return f"{change:38}  failed: {cells['failed']}"
    return f"{change:38}" + "".join(f"{_cell(cells.get(each)):>30}" for each in recordings)


def _cell(figures: Json | None) -> str:
    if figures is None:
        return "-"
    text = f"{1e3 * figures['ate_m']:.2f} ({1e3 * figures['global_m']:.2f})"
    text += f" lost {figures['lost']}" if figures["lost"] else ""
    return text + (f" gross {figures['gross']}" if figures["gross"] else "")


def run_row(change: str, recordings: Sequence[str]) -> int:
    """Change the constant before any kernel is compiled, then run every recording."""
    cv2.setNumThreads(1)
    if change != BASELINE:
        name, value = parse_change(change)
        if not hasattr(parameters, name):
            sys.exit(f"{parameters.__name__} has no {name}")
        setattr(parameters, name, value)
    print(json.dumps({each: evaluate_recording(each) for each in recordings}))
    return 0


def evaluate_recording(recording: str) -> Json | None:
    """Evaluate FOLDER or FOLDER@EVERY; None if there are too few poses."""
    from vo_service.odometry.direct import DirectOdometry

    folder, _, every = recording.partition("@")
    stamps_s, poses, epochs, failed = [], [], [], 0
    with RecordingCamera(Path(folder), None, PlaybackMode.LOCKSTEP) as camera:
        odometry, epoch, truth = DirectOdometry(), 0, camera.ground_truth
        for frame in islice(read_all_frames(camera), 0, None, int(every or 1)):
            estimate = odometry.estimate(frame)
            epoch += estimate.is_reset
            failed += not estimate.ok
            if estimate.ok:
                stamps_s.append(frame.stamp_s)
                poses.append(estimate.T_world_camera)
                epochs.append(epoch)
    assert truth is not None, f"{folder} has no ground truth"
    try:
        trajectory = Trajectory(np.array(stamps_s), np.array(poses))
        matched, evaluation = associate(trajectory, truth), evaluate(trajectory, truth)
    except InputError:
        return None
    steps = tracked_steps(matched, trajectory.stamps_s, np.array(epochs))
    return {
        "ate_m": evaluation.ate_rmse_m,
        "global_m": evaluation.mean_global_error_m,
        "lost": failed,
        "gross": count_gross_errors(matched, steps),
    }


if __name__ == "__main__":  # one row
    sys.exit(run_row(sys.argv[1], sys.argv[2:]))
