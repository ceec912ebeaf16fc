"""A file of results of long runs, so that finished runs are not repeated."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.core.errors import InputError

Json = dict[str, Any]


class ResultCache:
    """JSON objects by name in FOLDER/results.json, written after each."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError if the file was not written by this class."""
        self._file = folder / "results.json"
        self._results: dict[str, Json] = {}
        if self._file.exists():
            self._results = _read(self._file)

    def __contains__(self, name: str) -> bool:
        """Whether there is a result of a name."""
        return name in self._results

    def get_or_run(self, name: str, run: Callable[[], Json]) -> Json:
        """Return the result of a name; run and store it if there is none."""
        if name not in self._results:
            self._results[name] = json.loads(json.dumps(run()))
            part = self._file.with_name(self._file.name + ".part")
            part.write_text(json.dumps(self._results, indent=1))
            part.replace(self._file)
        return self._results[name]


def _read(file: Path) -> dict[str, Json]:
    try:
        results = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot read it ({error}); name another folder") from error
    if not isinstance(results, dict):
        raise InputError(f"{file}: has no results; name another folder")
    return results
