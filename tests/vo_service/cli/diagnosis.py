"""What `kinect-vo doctor --json` says, looked up by the name of a check."""

from typing import Any

Diagnosis = dict[str, Any]


def failed_checks(diagnosis: Diagnosis) -> dict[str, str]:
    """Name and text of what has failed."""
    return {
        check["name"]: check["text"] for check in diagnosis["checks"] if check["verdict"] == "fail"
    }


def find_check(diagnosis: Diagnosis, name: str) -> dict[str, Any]:
    """One check's finding."""
    found: dict[str, Any] = next(c for c in diagnosis["checks"] if c["name"] == name)
    return found
