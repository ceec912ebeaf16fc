"""Plots of figures over time: panels below each other."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from drivers.core.files import atomic_write
from vo_service.figures import new_figure, render_figure

# Label, and figures at positions on the axis.
Line = tuple[str, ArrayLike, ArrayLike]


def save_panels(file: Path, x_label: str, panels: Mapping[str, Sequence[Line]]) -> None:
    """Plot the lines of each panel, by the label of its axis, from 0 on."""
    figure = new_figure(8, 9, "tight")
    axes = figure.subplots(len(panels), 1, sharex=True)
    for axis, (y_label, lines) in zip(axes, panels.items(), strict=True):
        for label, x, y in lines:
            axis.plot(x, y, label=label, linewidth=1)
        axis.set_ylabel(y_label)
        axis.set_ylim(bottom=0)
        axis.grid(visible=True, alpha=0.3)
        axis.legend(loc="best", fontsize="small")
    axes[-1].set_xlabel(x_label)
    atomic_write(file, render_figure(figure, "png", dpi=100))
