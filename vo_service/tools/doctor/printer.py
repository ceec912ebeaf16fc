"""Findings as text: aligned lines on a terminal, whole lines in a log."""

import os
import shutil
import textwrap
from collections.abc import Sequence
from typing import TextIO

from vo_service.tools.doctor.check import CheckResult
from vo_service.tools.doctor.finding import CheckVerdict

SYMBOLS = {
    CheckVerdict.PASS: "✓",
    CheckVerdict.WARNING: "!",
    CheckVerdict.FAIL: "✗",
    CheckVerdict.UNKNOWN: "?",
    CheckVerdict.SKIPPED: "-",
}
PLAIN_SYMBOLS = SYMBOLS | {CheckVerdict.PASS: "+", CheckVerdict.FAIL: "x"}
GREEN, YELLOW, RED, FAINT, BOLD = "32", "33", "31", "2", "1"
COLORS = {
    CheckVerdict.PASS: GREEN,
    CheckVerdict.WARNING: YELLOW,
    CheckVerdict.FAIL: RED,
    CheckVerdict.UNKNOWN: FAINT,
    CheckVerdict.SKIPPED: FAINT,
}
MIN_WIDTH, MAX_WIDTH = 50, 100
FIX_PREFIX = "fix: "
NOT_CHECKED = "not checked"


class FindingPrinter:
    """Printer to a stream; on a terminal, long lines are wrapped and indented."""

    def __init__(self, stream: TextIO, names: Sequence[str]) -> None:
        """Set up the layout; `names` are those of all checks, for the width of their column."""
        self._stream = stream
        encoding = (stream.encoding or "").lower().replace("-", "")
        self._symbols = SYMBOLS if encoding.startswith("utf") else PLAIN_SYMBOLS
        self._has_color = stream.isatty() and not os.environ.get("NO_COLOR")
        self._name_width = max(len(name) for name in (*names, NOT_CHECKED))
        self._skipped: list[CheckResult] = []
        # Lines of a log are not wrapped: its reader's window may have any width.
        columns = shutil.get_terminal_size().columns
        self._width = min(max(columns, MIN_WIDTH), MAX_WIDTH) if stream.isatty() else 0

    def print_heading(self, text: str) -> None:
        """Print a heading before the checks."""
        self._write(f"{self._paint(text, BOLD)}\n")

    def print_result(self, result: CheckResult) -> None:
        """Print one check; successive skipped checks share a line."""
        if self._skipped and result.finding != self._skipped[0].finding:
            self._print_skipped()
        if result.finding.verdict is CheckVerdict.SKIPPED:
            self._skipped.append(result)
            return
        self._print_line(result.finding.verdict, result.name.replace("-", " "), result.finding.text)
        if result.finding.fix:
            prefix = self._paint(FIX_PREFIX, COLORS[result.finding.verdict])
            indent = self._name_width + 6
            self._print_block(" " * indent + prefix, indent + len(FIX_PREFIX), result.finding.fix)

    def print_conclusion(self, results: Sequence[CheckResult]) -> None:
        """Print the overall result."""
        if self._skipped:
            self._print_skipped()
        kinds = CheckVerdict.FAIL, CheckVerdict.WARNING, CheckVerdict.SKIPPED
        failures, warnings, skipped = (_names(results, kind) for kind in kinds)
        text, color = "all checks passed", GREEN
        if failures:
            rest = f", {len(skipped)} not checked" if skipped else ""
            text = f"{len(failures)} failed ({', '.join(failures)}){rest}: fix this and re-run"
            color = RED
        elif warnings:
            text, color = f"it works, with warnings: {', '.join(warnings)}", YELLOW
        self._write(f"\n{self._paint(text, color)}")

    def _print_skipped(self) -> None:
        names = ", ".join(result.name.replace("-", " ") for result in self._skipped)
        text = f"{names} ({self._skipped[0].finding.text})"
        self._skipped = []
        self._print_line(CheckVerdict.SKIPPED, NOT_CHECKED, text)

    def _print_line(self, verdict: CheckVerdict, name: str, text: str) -> None:
        symbol = self._paint(self._symbols[verdict], COLORS[verdict])
        faint = FAINT if verdict in (CheckVerdict.SKIPPED, CheckVerdict.UNKNOWN) else ""
        head = f"  {symbol} {name.ljust(self._name_width)}  "
        self._print_block(head, self._name_width + 6, text, faint)

    def _print_block(self, head: str, indent: int, text: str, color: str = "") -> None:
        """Print a text behind a head, whose width is the indent of further lines."""
        lines = [text]
        if self._width:
            width = self._width - indent
            lines = textwrap.wrap(text, width, break_on_hyphens=False, break_long_words=False)
        for line in lines or [""]:
            self._write(head + self._paint(line, color))
            head = " " * indent

    def _paint(self, text: str, color: str) -> str:
        return f"\x1b[{color}m{text}\x1b[0m" if self._has_color and color else text

    def _write(self, line: str) -> None:
        encoding = self._stream.encoding or "ascii"
        safe = line.encode(encoding, "replace").decode(encoding)
        self._stream.write(f"{safe.rstrip()}\n" if line.strip() else "\n")
        self._stream.flush()


def _names(results: Sequence[CheckResult], verdict: CheckVerdict) -> list[str]:
    return [
        result.name.replace("-", " ") for result in results if result.finding.verdict is verdict
    ]
