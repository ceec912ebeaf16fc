"""What `odometry ablation` changes: variants of the direct method, and their parameters.

Kernels contain the parameters as constants, and modules copy them at their import. So a variant
runs in processes of its own. These change the parameters before they import the method, and compile
its kernels into a folder of their own. This module must not import the method, as they import it
first.
"""

import os
import sys
from ast import literal_eval
from collections.abc import Mapping, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import cv2

from benchmarks.harness import Json, Table, format_counts, median_figure
from drivers.core import InputError
from vo_service import odometry

Value = float | tuple[float, ...]
Changes = Mapping[str, Value]

PARAMETERS_FILE = Path(odometry.__file__).parent / "direct" / "parameters.py"
PARAMETERS_MODULE = f"{odometry.__name__}.direct.parameters"
UNCHANGED = "as it is"
# A limit that is never reached.
NO_LIMIT = 10**9
# Changed parameters by variant. A change that would need code is no variant.
ABLATIONS: Mapping[str, Changes] = {
    "no-interpolation-variance": {"INTERPOLATION_PX": 0},
    "no-region-weights": {"MAX_REGION_COST_RATIO": NO_LIMIT},
    "t-5": {"DEGREES_OF_FREEDOM": 5},
    "t-30": {"DEGREES_OF_FREEDOM": 30},
    "half-the-points": {"POINT_BLOCKS": (46, 40, 20, 14)},
    "three-levels": {
        "POINT_BLOCKS": (64, 54, 27),
        "MAX_STEPS": (24, 24, 15),
        "MIN_STEP_SIZES": (2e-4, 7e-4, 2e-3),
    },
    "small-planes": {"PLANE_RADIUS_PX": 4},
    "dynamic-points-kept": {"MIN_OBSERVED_SHARE": 2},
    "no-robot-body": {"MIN_BODY_VIEWS": NO_LIMIT},
    "wide-velocity-prior": {"VELOCITY_SIGMA": (0.3, 1.0), "VELOCITY_SIGMA_RANGE": (1, 10)},
    "no-angular-acceleration": {"TREMOR_SPAN_S": 1000},
    "no-filter": {"MIN_PREDICTION_SHARE": NO_LIMIT},
    "no-vignetting": {"MAX_VIGNETTING": 0},
    "no-learned-depth-noise": {"NOISE_WINDOWS": 1},
    "no-joint-refinement": {"MAX_JOINT_KEYFRAMES": 0},
    "one-keyframe": {"MAX_KEYFRAMES": 1},
    "first-keyframe-not-rebuilt": {"REINITIALIZATIONS": 0},
    "no-surf-recovery": {"MAX_SEARCHED_KEYFRAMES": 0},
    "no-observability-after-a-gap": {"MIN_DISTANT_OBSERVABILITY": 0},
    "no-focal-length": {"FOCAL_PRIOR_SIGMA": 1e-6},
    "no-calibration-trial": {"MIN_TRIAL_GAIN": -NO_LIMIT},
    "no-timing-search": {
        "MIN_SEARCH_SCORE_GAIN": NO_LIMIT,
        "SUFFICIENT_SEARCH_SCORE_GAIN": NO_LIMIT,
    },
    "no-self-calibration": {
        "MIN_CALIBRATION_SPEED": NO_LIMIT,
        "MIN_SEARCH_SCORE_GAIN": NO_LIMIT,
        "SUFFICIENT_SEARCH_SCORE_GAIN": NO_LIMIT,
    },
}
ABLATION_TABLE = Table(44, "runs:6d", "ATE:9.2mm", "/ unchanged:13", "noise:13", "lost:8")


def load_parameters() -> ModuleType:
    """Execute parameters.py as a new module; one that is already imported stays as it is."""
    spec = spec_from_file_location(PARAMETERS_MODULE, PARAMETERS_FILE)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def parse_changes(words: Sequence[str]) -> Changes:
    """Parse changes of parameters, each "NAME=VALUE".

    Raises:
        InputError: One is no number or tuple of numbers.
    """
    changes = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            changes[name] = literal_eval(text)
        except (ValueError, SyntaxError) as error:
            raise InputError(f"--set {word}: must be NAME=NUMBER or NAME=(NUMBER, ...)") from error
    return changes


def check_changes(changes: Changes) -> Changes:
    """Return the changes with numbers of the parameters' types.

    Raises:
        InputError: A name is no parameter, or a value is of another kind than the parameter.
    """
    known = vars(load_parameters())
    for name in changes:
        if not name.isupper() or name not in known:
            raise InputError(f"parameter {name!r} is unknown; {PARAMETERS_FILE.name} has them all")
    return {name: _convert(name, value, known[name]) for name, value in changes.items()}


def _convert(name: str, value: object, current: Value) -> Value:
    if isinstance(current, tuple):
        if isinstance(value, tuple) and value:
            return tuple(_convert_number(name, each, current[0]) for each in value)
    elif not isinstance(value, tuple):
        return _convert_number(name, value, current)
    raise InputError(f"{name}={value}: must be of the kind of {current}")


def _convert_number(name: str, value: object, current: float) -> float:
    if type(value) is int or (type(value) is float and isinstance(current, float)):
        return type(current)(value)
    raise InputError(f"{name}={value}: must be of the kind of {current}")


def describe_changes(changes: Changes) -> str:
    """One line that names the changes; also the name of a folder."""
    return " ".join(f"{name}={value}".replace(" ", "") for name, value in changes.items())


def change_parameters(changes: Changes, kernels: Path) -> None:
    """Prepare a new process for a variant.

    Args:
        changes: Checked changes of parameters.
        kernels: Folder for the compiled kernels.

    Raises:
        RuntimeError: The method may have been imported already.
    """
    if "numba" in sys.modules:
        raise RuntimeError("parameters cannot be changed after kernels have been imported")
    os.environ["NUMBA_CACHE_DIR"] = str(kernels)
    parameters = load_parameters()
    vars(parameters).update(changes)
    sys.modules[PARAMETERS_MODULE] = parameters
    cv2.setNumThreads(1)


def format_ablation(
    groups: Mapping[str, Sequence[str]], results: Mapping[str, Mapping[str, Json]]
) -> str:
    """A row for each group and variant.

    Args:
        groups: Keys of the runs by group.
        results: Result of each run by key, by variant; that of `UNCHANGED` comes first.
    """
    lines = [ABLATION_TABLE.head]
    for group, keys in groups.items():
        lines.append(group)
        unchanged = results[UNCHANGED]
        unchanged_m = median_figure(unchanged, keys, "ate_m")
        ratios = [unchanged[key]["ate_m"] / unchanged_m for key in keys if unchanged[key]["ate_m"]]
        low, high = min(ratios, default=1.0), max(ratios, default=1.0)
        for variant, of_variant in results.items():
            ate_m, ratio = median_figure(of_variant, keys, "ate_m"), None
            if variant != UNCHANGED and ate_m is not None and unchanged_m:
                ratio = ate_m / unchanged_m
            lines.append(
                ABLATION_TABLE.row(
                    f"  {variant}",
                    len(keys),
                    ate_m,
                    None if ratio is None else f"{ratio:.2f}" + " *"[not low <= ratio <= high],
                    f"{low:.2f}-{high:.2f}" if variant == UNCHANGED else "",
                    format_counts([of_variant[key]["failed"] for key in keys]),
                )
            )
    return "\n".join(lines)
