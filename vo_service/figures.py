"""Figures of matplotlib without pyplot: no global state, no window."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.core.files import atomic_write, check_suffix
from drivers.core.write_errors import check_output_file

if TYPE_CHECKING:  # rarely used, and slow to import
    from matplotlib.figure import Figure


def new_figure(width_in: float, height_in: float, layout: str | None = "constrained") -> "Figure":
    """Make a figure of this size in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout=layout)  # type: ignore[arg-type]
    FigureCanvasAgg(figure)
    return figure


def render_figure(figure: "Figure", file_format: str, **settings: Any) -> bytes:
    """Return the content of a file; `settings` are those of `Figure.savefig`."""
    data = io.BytesIO()
    figure.savefig(data, format=file_format, **settings)
    return data.getvalue()


def write_figure(
    path: Path, formats: Sequence[str], draw: Callable[[], "Figure"], **settings: Any
) -> None:
    """Draw a figure and write it in the format of the suffix. No partial file is left.

    Args:
        formats: Suffixes that are valid.
        settings: As for `render_figure`.

    Raises:
        InputError: The suffix is not valid, or no file can have this name; or of `draw`.
        WriteError: The file cannot be written.
    """
    file_format = check_suffix(path, formats).removeprefix(".")
    check_output_file(path)
    atomic_write(path, render_figure(draw(), file_format, **settings))
