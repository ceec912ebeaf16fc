"""Plot of a soak test: memory, handles, threads, latency and processor time over the frames."""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes

from benchmarks.soak_record import SoakRecord, SoakSample

PlottedFigure = tuple[str, Callable[[SoakSample], float]]
PANELS: tuple[tuple[str, tuple[PlottedFigure, ...]], ...] = (
    (
        "memory, MB",
        (("service", lambda s: s.service_mb), ("its children", lambda s: s.others_mb)),
    ),
    (
        "count",
        (
            ("open handles", lambda s: s.handles),
            ("threads", lambda s: s.threads),
            ("children", lambda s: s.children),
        ),
    ),
    ("latency, ms", (("median", lambda s: s.p50_ms), ("99 %", lambda s: s.p99_ms))),
    ("CPU, ms per frame", (("all processes", lambda s: s.cpu_ms),)),
)


def save_plot(record: SoakRecord, file: Path) -> None:
    """Plot all samples; dotted lines mark restarts of the service."""
    mpl.use("Agg")
    from matplotlib import pyplot

    before = [sum(s.frame for s in _run_ends(record)[:run]) for run in range(record.runs)]
    at = [(before[sample.run] + sample.frame) / 1000 for sample in record.samples]
    figure, axes = pyplot.subplots(len(PANELS), 1, sharex=True, figsize=(8, 9), layout="tight")
    for axis, (label, lines) in zip(axes, PANELS, strict=True):
        _draw(axis, label, lines, at, record)
        for frames in before[1:]:
            axis.axvline(frames / 1000, color="gray", linestyle=":")
    axes[-1].set_xlabel("thousand frames")
    figure.savefig(file, dpi=100)
    pyplot.close(figure)


def _draw(
    axis: Axes, label: str, lines: tuple[PlottedFigure, ...], at: list[float], record: SoakRecord
) -> None:
    for name, value in lines:
        axis.plot(at, [value(sample) for sample in record.samples], label=name, linewidth=1)
    axis.set_ylabel(label)
    axis.set_ylim(bottom=0)
    axis.grid(visible=True, alpha=0.3)
    axis.legend(loc="lower right", fontsize="small")


def _run_ends(record: SoakRecord) -> list[SoakSample]:
    return list({sample.run: sample for sample in record.samples}.values())
