"""Findings for a person: aligned lines on a terminal, plain ones in a log."""

import os
import shutil
import textwrap
from collections.abc import Sequence
from typing import TextIO

from vo_service.doctor.finding import Verdict
from vo_service.doctor.runner import Result

SYMBOLS = {
    Verdict.PASS: "✓",
    Verdict.WARNING: "!",
    Verdict.FAIL: "✗",
    Verdict.UNKNOWN: "?",
    Verdict.SKIPPED: "-",
}
PLAIN_SYMBOLS = SYMBOLS | {Verdict.PASS: "+", Verdict.FAIL: "x"}
GREEN, YELLOW, RED, FAINT, BOLD = "32", "33", "31", "2", "1"
COLOURS = {
    Verdict.PASS: GREEN,
    Verdict.WARNING: YELLOW,
    Verdict.FAIL: RED,
    Verdict.UNKNOWN: FAINT,
    Verdict.SKIPPED: FAINT,
}
NARROWEST, WIDEST = 50, 100
FIX = "fix: "
NOT_CHECKED = "not checked"


class NoPrinter:
    """For programs, which read JSON."""

    def heading(self, text: str) -> None:
        """See `Printer`."""

    def result(self, result: Result) -> None:
        """See `Printer`."""

    def conclusion(self, found: Sequence[Result]) -> None:
        """See `Printer`."""


class Printer:
    """Writes to one stream; what is too long for a line goes on below, indented."""

    def __init__(self, stream: TextIO, names: Sequence[str]) -> None:
        """`names` are those of all checks that will come, for the width of their column."""
        self._stream = stream
        encoding = (stream.encoding or "").lower().replace("-", "")
        self._symbols = SYMBOLS if encoding.startswith("utf") else PLAIN_SYMBOLS
        self._has_colour = stream.isatty() and not os.environ.get("NO_COLOR")
        self._name_width = max(len(name) for name in (*names, NOT_CHECKED))
        self._skipped: list[Result] = []
        # A log is read in a window of any width: its lines are left whole.
        columns = shutil.get_terminal_size().columns
        self._width = min(max(columns, NARROWEST), WIDEST) if stream.isatty() else 0

    def heading(self, text: str) -> None:
        """A line of its own, before the checks."""
        self._write(f"{self._paint(text, BOLD)}\n")

    def result(self, result: Result) -> None:
        """One check; those that were skipped one after another share a line."""
        if self._skipped and result.finding != self._skipped[0].finding:
            self._skipped_together()
        if result.finding.verdict is Verdict.SKIPPED:
            self._skipped.append(result)
            return
        self._line(result.finding.verdict, result.name.replace("-", " "), result.finding.text)
        if result.finding.fix:
            fix, *rest = self._wrapped(result.finding.fix, len(FIX))
            self._below(self._paint(FIX, COLOURS[result.finding.verdict]) + fix)
            for line in rest:
                self._below(" " * len(FIX) + line)

    def conclusion(self, found: Sequence[Result]) -> None:
        """What it all comes to."""
        if self._skipped:
            self._skipped_together()
        by_verdict = {kind: _names(found, kind) for kind in Verdict}
        failures, warnings = by_verdict[Verdict.FAIL], by_verdict[Verdict.WARNING]
        skipped = by_verdict[Verdict.SKIPPED]
        if failures:
            rest = f", {len(skipped)} not checked" if skipped else ""
            text = f"{len(failures)} failed ({', '.join(failures)}){rest}: mend that, run it again"
            self._write(f"\n{self._paint(text, RED)}")
        elif warnings:
            text = f"it works; look at {', '.join(warnings)}"
            self._write(f"\n{self._paint(text, YELLOW)}")
        else:
            self._write(f"\n{self._paint('all is well', GREEN)}")

    def _skipped_together(self) -> None:
        names = ", ".join(result.name.replace("-", " ") for result in self._skipped)
        text = f"{names} ({self._skipped[0].finding.text})"
        self._skipped = []
        self._line(Verdict.SKIPPED, NOT_CHECKED, text)

    def _line(self, verdict: Verdict, name: str, text: str) -> None:
        symbol = self._paint(self._symbols[verdict], COLOURS[verdict])
        faint = FAINT if verdict in (Verdict.SKIPPED, Verdict.UNKNOWN) else ""
        first, *rest = (self._paint(line, faint) for line in self._wrapped(text))
        self._write(f"  {symbol} {name.ljust(self._name_width)}  {first}")
        for line in rest:
            self._below(line)

    def _wrapped(self, text: str, indent: int = 0) -> list[str]:
        if not self._width:
            return [text]
        width = self._width - self._name_width - 6 - indent
        return textwrap.wrap(text, width, break_on_hyphens=False, break_long_words=False) or [""]

    def _below(self, line: str) -> None:
        self._write(f"{' ' * (self._name_width + 6)}{line}")

    def _paint(self, text: str, colour: str) -> str:
        return f"\x1b[{colour}m{text}\x1b[0m" if self._has_colour and colour else text

    def _write(self, line: str) -> None:
        encoding = self._stream.encoding or "ascii"
        safe = line.encode(encoding, "replace").decode(encoding)
        self._stream.write(f"{safe.rstrip()}\n" if line.strip() else "\n")
        self._stream.flush()


def _names(found: Sequence[Result], kind: Verdict) -> list[str]:
    return [result.name.replace("-", " ") for result in found if result.finding.verdict is kind]
