"""Tours as a picture: error, processor time and memory over the minutes."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from benchmarks.tour_record import TourRecord
from drivers.geometry import Array
from drivers.trajectory import StampedPoses
from vo_service.evaluation.association import associate
from vo_service.evaluation.metrics import best_alignment, position_errors_m

# Times and memory are drawn as the mean, and the 99th percentile, of so many seconds.
WINDOW_S = 10.0
LABELS = ("distance from the truth, mm", "CPU, ms a frame", "memory, MB")


def save_plot(records: Mapping[str, TourRecord], file: Path) -> None:
    """Draw all tours over one another. Raises InputError if one has hardly a pose."""
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
    for what, poses in (("as given", record.trajectory), ("corrected", record.corrected)):
        stamps_s, errors_m = _errors(poses, record.truth)
        axes[0].plot(stamps_s / 60.0, 1e3 * errors_m, label=f"{name}, {what}", linewidth=1)
    window = (record.stamp_s // WINDOW_S).astype(int)
    minutes = (np.unique(window) + 0.5) * WINDOW_S / 60.0
    cpu_ms = [record.cpu_ms[window == each] for each in np.unique(window)]
    memory_mb = [record.memory_mb[window == each].mean() for each in np.unique(window)]
    axes[1].plot(minutes, [part.mean() for part in cpu_ms], label=f"{name}, mean", linewidth=1)
    p99_ms = [np.percentile(part, 99) for part in cpu_ms]
    axes[1].plot(minutes, p99_ms, label=f"{name}, 99 %", linewidth=1)
    axes[2].plot(minutes, memory_mb, label=name, linewidth=1)


def _errors(poses: StampedPoses, truth: StampedPoses) -> tuple[Array, Array]:
    """Stamps and distances of the poses, laid on the truth as well as can be."""
    matched = associate(poses, truth)
    return matched.stamps_s, position_errors_m(matched, best_alignment(matched))
