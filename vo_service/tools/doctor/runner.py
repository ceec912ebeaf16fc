"""Run checks in order; those that need a failed one are not run."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Check, CheckVerdict, Finding, skipped, unknown

_log = logging.getLogger(__name__)
ShowBusy = Callable[[str], AbstractContextManager[object]]


@dataclass(frozen=True)
class CheckResult:
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


def run_checks(
    checks: Sequence[Check], context: CheckContext, show_busy: ShowBusy
) -> Iterator[CheckResult]:
    """Every check's result as soon as there is one.

    `busy` shows what is being checked. Raises InputError for what the user gave.
    """
    blocked_by: dict[str, str] = {}
    for check in checks:
        needed = next((blocked_by[name] for name in check.needs if name in blocked_by), "")
        if needed:
            finding = skipped(needed)
        else:
            with show_busy(check.name):
                finding = _run_check(check, context)
        if finding.verdict in (CheckVerdict.FAIL, CheckVerdict.SKIPPED):
            blocked_by[check.name] = needed or check.name
        _log.debug("%s: %s: %s", check.name, finding.verdict, finding.text)
        yield CheckResult(check.name, finding)


def _run_check(check: Check, context: CheckContext) -> Finding:
    try:
        return check.run(context)
    except OSError as error:  # a file of the system that this user may not read, or that went away
        return unknown(f"not known: {error}")


def overall_verdict(results: Sequence[CheckResult]) -> CheckVerdict:
    """Fail if any check failed."""
    has_failed = any(result.finding.verdict is CheckVerdict.FAIL for result in results)
    return CheckVerdict.FAIL if has_failed else CheckVerdict.PASS


def diagnosis_as_json(source: str, results: Sequence[CheckResult]) -> dict[str, object]:
    """The whole diagnosis; the keys stay."""
    return {
        "schema": 1,
        "camera": source,
        "verdict": overall_verdict(results),
        "checks": [result.as_json() for result in results],
    }
