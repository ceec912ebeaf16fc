"""Reports: tables, as text for people and as CSV for scripts, and settings and versions."""

import csv
import io
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from drivers.core.config import SCHEMA_VERSION
from vo_service.config import Config, OdometryConfig
from vo_service.terminal import make_console
from vo_service.tools.benchmark import CompletedRun, LoopClosureRun, collect_versions
from vo_service.tools.benchmark.methods import SfmScale
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.results import RunEvaluation

if TYPE_CHECKING:
    from rich.text import Text

# A table that is wider than the terminal is not cut.
MAX_WIDTH = 1000


@dataclass(frozen=True)
class TableCell:
    """Cell with a value for scripts (None if not known) and a text for people."""

    value: float | str | None
    text: str
    is_best: bool = False


@dataclass(frozen=True)
class Table:
    """Table with named columns.

    Attributes:
        name: Name of its file.
        title: Title for people.
        keys: Column names for scripts.
        headings: Column headings for people.
        rows: Cells by row.
    """

    name: str
    title: str
    keys: Sequence[str]
    headings: Sequence[str]
    rows: Sequence[Sequence[TableCell]]

    def as_csv(self) -> str:
        """Return comma-separated values with full precision; empty if not known."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.keys)
        for row in self.rows:
            writer.writerow("" if cell.value is None else cell.value for cell in row)
        return text.getvalue()

    def as_text(self) -> str:
        """Return aligned columns below the title; the best cell of a row has a star."""
        text = io.StringIO()
        self.write(text)
        return "\n".join(line.rstrip() for line in text.getvalue().splitlines())

    def write(self, stream: TextIO) -> None:
        """Write the same to a stream; on a terminal, headings and best cells are bold."""
        from rich import table  # slow to import

        columns = [
            table.Column(f"{heading} ", justify="right" if number else "left", no_wrap=True)
            for number, heading in enumerate(self.headings)
        ]
        grid = table.Table(*columns, box=None, pad_edge=False, header_style="bold")
        for row in self.rows:
            grid.add_row(*(_format_cell(cell) for cell in row))
        console = make_console(stream, MAX_WIDTH)
        console.print(self.title, style="bold")
        console.print(grid)


def _format_cell(cell: TableCell) -> "Text":
    from rich.text import Text

    return Text(f"{cell.text}*", style="bold green") if cell.is_best else Text(f"{cell.text} ")


def number_cell(
    value: float | None, digits: int, display_factor: float = 1.0, is_best: bool = False
) -> TableCell:
    """Make a cell of a number; digits and factor apply to the displayed text only.

    Args:
        value: The number; None if not known.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed number.
        is_best: Whether it is the best of its row.
    """
    if value is None:
        return TableCell(None, "-")
    return TableCell(value, f"{display_factor * value:.{digits}f}", is_best)


def text_cell(value: str, text: str | None = None) -> TableCell:
    """Make a cell of a text, with an optional other text for people."""
    return TableCell(value, value if text is None else text)


MetricFunction = Callable[[RunEvaluation], float | None]


@dataclass(frozen=True)
class MetricColumn:
    """Column of a metric.

    Attributes:
        key: Name for scripts.
        heading: Heading for people.
        value: Function that returns the metric of a run.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed value.
    """

    key: str
    heading: str
    value: MetricFunction
    digits: int
    display_factor: float = 1.0


def from_evaluation(key: str) -> MetricFunction:
    """Return a function for a field of the `Evaluation`, None without one."""
    return lambda evaluation: getattr(evaluation.evaluation, key) if evaluation.evaluation else None


def from_optimized_evaluation(key: str) -> MetricFunction:
    """Return a function for a field of the optimized trajectory's `Evaluation`."""
    return lambda evaluation: (
        getattr(evaluation.optimized_evaluation, key) if evaluation.optimized_evaluation else None
    )


def from_loop_closure(value: Callable[[LoopClosureRun], float]) -> MetricFunction:
    """Return a function for a value of a run's loop closure, None without it."""

    def loop_closure_value(evaluation: RunEvaluation) -> float | None:
        run = evaluation.outcome.run.loop_closure
        return None if run is None else value(run)

    return loop_closure_value


def from_run(value: Callable[[CompletedRun], float]) -> MetricFunction:
    """Return a function for a value of a complete run, None for others."""
    return lambda evaluation: value(evaluation.outcome.run) if evaluation.is_done else None


def format_effective_config(
    odometry: OdometryConfig,
    camera_file: Path | None,
    tables: Mapping[str, Mapping[str, object]],
    *notes: str,
) -> str:
    """Format a configuration for `--config`.

    Args:
        odometry: The table `[odometry]`.
        camera_file: Camera file; None if not given.
        tables: Additional tables by name.
        *notes: Comments at the top.
    """
    camera = [] if camera_file is None else _format_table("camera", {"file": camera_file})
    summary = "Settings of the methods; all other settings have default values or are not used."
    comments = [f"# {note}" for note in (summary, *notes)]
    odometry_lines = _format_table("odometry", asdict(odometry))
    other_lines = [line for name, values in tables.items() for line in _format_table(name, values)]
    lines = [*comments, f"schema = {SCHEMA_VERSION}", *camera, *odometry_lines, *other_lines]
    return "\n".join(lines) + "\n"


def _format_table(name: str, values: Mapping[str, object]) -> list[str]:
    """Format a TOML table; texts, numbers and lists are written as in JSON."""
    keys = [
        f"{key} = {json.dumps(value, default=str, ensure_ascii=False)}"
        for key, value in values.items()
        if value is not None
    ]
    return ["", f"[{name}]", *keys]


@dataclass(frozen=True)
class ComparisonMetadata:
    """Settings of a comparison.

    Attributes:
        methods: Methods that run, in order.
        config: Configuration of our methods.
        sfm_scale: Source of the first scale of `sfm`.
        camera_file: Camera file for all recordings; None for each recording's own.
        time_limit_s: Time limit of each run.
        observer_factory: Made the observer of each run.
        created: Time of the comparison.
    """

    methods: Sequence[str]
    config: Config
    sfm_scale: SfmScale
    camera_file: Path | None
    time_limit_s: float
    observer_factory: ObserverFactory = NULL_OBSERVER
    created: datetime = field(default_factory=lambda: datetime.now(UTC))

    @property
    def config_text(self) -> str:
        """The effective configuration, in the format of `--config`."""
        return format_effective_config(
            self.config.odometry,
            self.camera_file,
            self.observer_factory.config_tables,
            f"Methods: {', '.join(self.methods)}; `method` below applies to runs of the service.",
            f"First scale of sfm: --sfm-scale {self.sfm_scale}",
        )

    def as_json(self) -> dict[str, Any]:
        """Return the settings and versions for report.json."""
        return {
            "created": self.created.isoformat(timespec="seconds"),
            "methods": list(self.methods),
            "odometry": asdict(self.config.odometry),
            "sfm_scale": self.sfm_scale,
            "camera_file": None if self.camera_file is None else str(self.camera_file),
            "time_limit_s": self.time_limit_s,
            **self.observer_factory.settings,
            "versions": collect_versions(),
            "processors": os.cpu_count(),
        }
