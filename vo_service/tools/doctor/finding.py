"""What a check has found."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class CheckVerdict(StrEnum):
    """Result of a check; --json has these values."""

    PASS = "pass"
    WARNING = "warning"  # works only in part, or may fail
    FAIL = "fail"
    UNKNOWN = "unknown"  # this computer or this camera gives no answer
    SKIPPED = "skipped"  # a check that this one needs has failed


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes:
        verdict: Result of the check.
        text: What the check found, one line.
        fix: What to do about it, one line; "" if nothing.
        facts: The same for programs: numbers, texts or lists of them; the names have units.
    """

    verdict: CheckVerdict
    text: str
    fix: str = ""
    facts: Mapping[str, object] = field(default_factory=dict)


def passed(text: str, **facts: object) -> Finding:
    """Return a finding without a problem."""
    return Finding(CheckVerdict.PASS, text, facts=facts)


def warned(text: str, fix: str, **facts: object) -> Finding:
    """Return a finding of something that works with a limitation."""
    return Finding(CheckVerdict.WARNING, text, fix, facts)


def failed(text: str, fix: str, **facts: object) -> Finding:
    """Return a finding of something that does not work."""
    return Finding(CheckVerdict.FAIL, text, fix, facts)


def unknown(text: str) -> Finding:
    """Return a finding of something that cannot be known here."""
    return Finding(CheckVerdict.UNKNOWN, text)


def skipped(needed: str) -> Finding:
    """Return the finding of a check that did not run because the check `needed` failed."""
    return Finding(CheckVerdict.SKIPPED, f"because {needed.replace('-', ' ')} failed")
