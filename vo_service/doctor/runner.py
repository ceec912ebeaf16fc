"""Run checks in order; those that need a failed one are not run."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

from vo_service.doctor.context import Context
from vo_service.doctor.finding import Check, Finding, Verdict, skipped, unknown

_log = logging.getLogger(__name__)
Busy = Callable[[str], AbstractContextManager[object]]


@dataclass(frozen=True)
class Result:
    """One check and what it found."""

    name: str
    finding: Finding

    def as_json(self) -> dict[str, object]:
        """For --json; the keys stay."""
        finding = self.finding
        return {
            "name": self.name,
            "verdict": finding.verdict,
            "text": finding.text,
            "fix": finding.fix,
            "facts": dict(finding.facts),
        }


def results(checks: Sequence[Check], context: Context, busy: Busy) -> Iterator[Result]:
    """Every check's result as soon as there is one.

    `busy` shows what is being checked. Raises InputError for what the user gave.
    """
    blocked_by: dict[str, str] = {}
    for check in checks:
        needed = next((blocked_by[name] for name in check.needs if name in blocked_by), "")
        if needed:
            finding = skipped(needed)
        else:
            with busy(check.name):
                finding = _run(check, context)
        if finding.verdict in (Verdict.FAIL, Verdict.SKIPPED):
            blocked_by[check.name] = needed or check.name
        _log.debug("%s: %s: %s", check.name, finding.verdict, finding.text)
        yield Result(check.name, finding)


def _run(check: Check, context: Context) -> Finding:
    try:
        return check.run(context)
    except OSError as error:  # a file of the system that this user may not read, or that went away
        return unknown(f"not known: {error}")


def verdict(found: Sequence[Result]) -> Verdict:
    """Fail if any check failed."""
    has_failed = any(result.finding.verdict is Verdict.FAIL for result in found)
    return Verdict.FAIL if has_failed else Verdict.PASS


def as_json(source: str, found: Sequence[Result]) -> dict[str, object]:
    """The whole diagnosis; the keys stay."""
    return {
        "schema": 1,
        "camera": source,
        "verdict": verdict(found),
        "checks": [result.as_json() for result in found],
    }
