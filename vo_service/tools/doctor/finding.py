"""What a check is, and what it finds."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from vo_service.tools.doctor.context import CheckContext


class CheckVerdict(StrEnum):
    """How a check ended; the values are those of --json."""

    PASS = "pass"
    WARNING = "warning"  # works, but not all of it or not for sure
    FAIL = "fail"
    UNKNOWN = "unknown"  # this computer or this camera does not tell
    SKIPPED = "skipped"  # a check that this one needs has failed


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    text   one line: what is so
    fix    one line: what to do about it; "" where nothing need be done
    facts  the same for programs; names carry units, values are numbers, texts or lists of these
    """

    verdict: CheckVerdict
    text: str
    fix: str = ""
    facts: Mapping[str, object] = field(default_factory=dict)


def passed(text: str, **facts: object) -> Finding:
    """All is well."""
    return Finding(CheckVerdict.PASS, text, facts=facts)


def warned(text: str, fix: str, **facts: object) -> Finding:
    """It works, but."""
    return Finding(CheckVerdict.WARNING, text, fix, facts)


def failed(text: str, fix: str, **facts: object) -> Finding:
    """It does not work."""
    return Finding(CheckVerdict.FAIL, text, fix, facts)


def unknown(text: str) -> Finding:
    """Nobody tells."""
    return Finding(CheckVerdict.UNKNOWN, text)


def skipped(needed: str) -> Finding:
    """Not run, because the check `needed` has failed."""
    return Finding(CheckVerdict.SKIPPED, f"since {needed.replace('-', ' ')} failed")


class Check(Protocol):
    """One question about the machine or the camera."""

    @property
    def name(self) -> str:
        """Stable, for --json: lower case, words joined by "-"."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of checks that must not have failed; each comes before this one."""
        ...

    def run(self, context: "CheckContext") -> Finding:
        """Answer it. Raises InputError for what the user gave; nothing else."""
        ...
