"""Run checks in order, without those that need a failed check."""

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
    """Name and finding of one check."""

    name: str
    finding: Finding

    def as_json(self) -> dict[str, object]:
        """Return the result for --json; the keys are stable."""
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
    """Yield the result of each check as soon as it is known.

    Args:
        checks: Checks to run; each comes after those it needs.
        context: Data for the checks.
        show_busy: Shows the name of a check while it runs.

    Raises:
        InputError: The user's input is invalid.
    """
    blocked_by: dict[str, str] = {}
    for check in checks:
        failed_check = next((blocked_by[name] for name in check.needs if name in blocked_by), "")
        if failed_check:
            finding = skipped(failed_check)
        else:
            with show_busy(check.name):
                finding = _run_check(check, context)
        if finding.verdict in (CheckVerdict.FAIL, CheckVerdict.SKIPPED):
            blocked_by[check.name] = failed_check or check.name
        _log.debug("%s: %s: %s", check.name, finding.verdict, finding.text)
        yield CheckResult(check.name, finding)


def _run_check(check: Check, context: CheckContext) -> Finding:
    try:
        return check.run(context)
    except OSError as error:  # a system file is not readable or has disappeared
        return unknown(f"not known: {error}")


def overall_verdict(results: Sequence[CheckResult]) -> CheckVerdict:
    """Return FAIL if any check failed, else PASS."""
    has_failed = any(result.finding.verdict is CheckVerdict.FAIL for result in results)
    return CheckVerdict.FAIL if has_failed else CheckVerdict.PASS


def diagnosis_as_json(source: str, results: Sequence[CheckResult]) -> dict[str, object]:
    """Return all results for --json; the keys are stable."""
    return {
        "schema": 1,
        "camera": source,
        "verdict": overall_verdict(results),
        "checks": [result.as_json() for result in results],
    }
