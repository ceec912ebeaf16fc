"""The tables of the bench: two for people, one for scripts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from vo_service.bench.metrics import (
    COMPARED,
    CPU,
    ERRORS,
    HONESTY,
    LOOPS,
    LOOPS_CPU,
    MEMORY,
    METRICS,
    WALL,
    ratio,
)
from vo_service.runs.judging import Judgement
from vo_service.runs.metric import Metric
from vo_service.runs.results import SequenceResults
from vo_service.runs.table import Cell, Table, number, words

# With a ratio in parentheses; the other ratios are in the files.
SHOWN_RATIOS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


@dataclass(frozen=True)
class Ranking:
    """The results of one recording at one rate, beside those of the method `against`."""

    result: SequenceResults
    against: str

    @property
    def other(self) -> Judgement:
        """What the others are divided by."""
        return self.result.judged[self.against]

    @property
    def title(self) -> str:
        """Which frames these are."""
        recording = self.result.recording
        every = recording.excerpt.every
        frames = f"{len(recording.frames_s)} frames in {recording.duration_s:.1f} s"
        used = "every frame" if every == 1 else f"1 frame in {every}"
        truth = "" if recording.truth is not None else ", no groundtruth.txt: errors are not known"
        return f"{recording.folder.resolve().name}, {used}: {frames}{truth}"

    def error_table(self) -> Table:
        """How far off, how often lost."""
        title = f"{self.title}; in () times that of {self.against}"
        loops = LOOPS if self.result.has_loops else ()
        return self._table(title, (*ERRORS, *HONESTY, *loops))

    def cost_table(self) -> Table:
        """Time a frame, and memory."""
        loops = (LOOPS_CPU,) if self.result.has_loops else ()
        return self._table("", (*CPU, *WALL, MEMORY, *loops))

    def _table(self, title: str, metrics: Sequence[Metric]) -> Table:
        rows = [
            [_name(method, judged), *(self._cell(metric, judged) for metric in metrics)]
            for method, judged in self.result.judged.items()
        ]
        keys = ["method", *(metric.key for metric in metrics)]
        return Table("", title, keys, ["method", *(metric.heading for metric in metrics)], rows)

    def _cell(self, metric: Metric, judged: Judgement) -> Cell:
        cell = number(metric.value(judged), metric.digits, metric.factor)
        times = ratio(metric, judged, self.other) if metric.key in SHOWN_RATIOS else None
        return cell if times is None else replace(cell, text=f"{cell.text} ({times:.2f})")


def bench_table(rankings: Sequence[Ranking]) -> Table:
    """For scripts: one row a recording, rate and method, every figure and every ratio."""
    about = ["sequence", "every", "frames", "method", "state", "trouble"]
    figures = [metric.key for metric in METRICS]
    times = [f"{metric.key}_ratio" for metric in COMPARED]
    loops = (*LOOPS, LOOPS_CPU) if any(each.result.has_loops for each in rankings) else ()
    rows = [
        [
            *_about(ranking.result, method, judged),
            *(number(metric.value(judged), metric.digits) for metric in METRICS),
            *(number(ratio(metric, judged, ranking.other), 3) for metric in COMPARED),
            *(number(metric.value(judged), metric.digits) for metric in loops),
        ]
        for ranking in rankings
        for method, judged in ranking.result.judged.items()
    ]
    keys = [*about, *figures, *times, *(metric.key for metric in loops)]
    return Table("bench", "Every figure", keys, keys, rows)


def _about(result: SequenceResults, method: str, judged: Judgement) -> list[Cell]:
    recording = result.recording
    return [
        words(recording.folder.resolve().name),
        number(recording.excerpt.every, 0),
        number(len(recording.frames_s), 0),
        words(method),
        words(judged.outcome.state),
        words(judged.outcome.trouble),
    ]


def _name(method: str, judged: Judgement) -> Cell:
    """A run without a result says so."""
    return words(method, method if judged.is_done else f"{method}: {judged.outcome.state}")
