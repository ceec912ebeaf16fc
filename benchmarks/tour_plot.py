"""Plot of tours: error, processor time and memory over time."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from benchmarks.tour_record import TourRecord
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.metrics import best_alignment, position_errors_m

# Times and memory are plotted as mean and 99th percentile of windows of this length.
WINDOW_S = 10.0
LABELS = ("distance from the truth, mm", "CPU, ms per frame", "memory, MB")


def save_plot(records: Mapping[str, TourRecord], file: Path) -> None:
    """Plot all tours together. Raises InputError if one has too few poses."""
    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(len(LABELS), 1, sharex=True, figsize=(8, 8), layout="tight")
    for name, record in records.items():
        _draw(axes, name, record)
    for axis, label in zip(axes, LABELS, strict=True):
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
        axis.grid(visible=True, alpha=0.3)
        axis.legend(loc="upper left", fontsize="small")
    axes[-1].set_xlabel("minutes")
    figure.savefig(file, dpi=100)
    pyplot.close(figure)


def _draw(axes: list[Axes], name: str, record: TourRecord) -> None:
    for what, poses in (("estimated", record.trajectory), ("optimized", record.optimized)):
        stamps_s, errors_m = _errors(poses, record.truth)
        axes[0].plot(stamps_s / 60.0, 1e3 * errors_m, label=f"{name}, {what}", linewidth=1)
    parts = _windows(record)
    minutes = [(n + 0.5) * WINDOW_S / 60.0 for n in range(len(parts))]
    lines = (
        (axes[1], "poses, mean", [record.cpu_ms[part].mean() for part in parts]),
        (axes[1], "poses, 99 %", [np.percentile(record.cpu_ms[part], 99) for part in parts]),
        (axes[1], "loop closure, mean", [record.loop_closure_ms[part].mean() for part in parts]),
        (axes[2], "", [record.memory_mb[part].mean() for part in parts]),
    )
    for axis, what, values in lines:
        axis.plot(minutes, values, label=f"{name}, {what}".rstrip(", "), linewidth=1)


def _windows(record: TourRecord) -> list[NDArray[np.intp]]:
    """Indices of the frames of each window, in order."""
    window = ((record.stamp_s - record.stamp_s[0]) // WINDOW_S).astype(int)
    return [np.flatnonzero(window == each) for each in np.unique(window)]


def _errors(poses: Trajectory, truth: Trajectory) -> tuple[Array, Array]:
    """Stamps, and distances of the poses from the truth after the best alignment."""
    matched = associate(poses, truth)
    return matched.stamps_s, position_errors_m(matched, best_alignment(matched))
