"""The bench's files: every figure for scripts, and what it was made with."""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vo_service.bench.contestants import LeftOut
from vo_service.bench.metrics import figures, ratios
from vo_service.bench.peers.catalogue import PEERS
from vo_service.bench.tables import Ranking, bench_table
from vo_service.config import OdometrySettings
from vo_service.runs.effective_config import effective_config
from vo_service.runs.keeping import write_file
from vo_service.runs.listening import NOBODY, ListenerRecipe
from vo_service.runs.versions import versions

DATA, TABLE, CONFIG = "report.json", "bench.csv", "config.toml"


@dataclass(frozen=True)
class SetUp:
    """The choices of a bench.

    methods      those that take part, in order
    left_out     those that could not
    against      the method whose figures the others are divided by
    every        of so many frames one is used; one pass over the recordings each
    frames       only the first so many of each recording; None: all
    camera_file  given for all folders; None: each folder's own
    listener     who heard what the methods said
    """

    methods: Sequence[str]
    left_out: Sequence[LeftOut]
    against: str
    every: Sequence[int]
    frames: int | None
    odometry: OdometrySettings
    camera_file: Path | None
    time_limit_s: float
    listener: ListenerRecipe = NOBODY
    created: datetime = field(default_factory=lambda: datetime.now(UTC))

    def as_json(self) -> dict[str, Any]:
        """For report.json."""
        packages = {PEERS[name].package for name in self.methods if name in PEERS}
        peers = {package.pip_names[0]: package.version for package in packages}
        return {
            "created": self.created.isoformat(timespec="seconds"),
            "methods": list(self.methods),
            "left_out": [each.as_json() for each in self.left_out],
            "against": self.against,
            "every": list(self.every),
            "first_frames": self.frames,
            "odometry": asdict(self.odometry),
            "camera_file": None if self.camera_file is None else str(self.camera_file),
            "time_limit_s": self.time_limit_s,
            **self.listener.settings,
            "versions": {**versions(), **dict(sorted(peers.items()))},
            "processors": os.cpu_count(),
        }


def content_of(set_up: SetUp, rankings: Sequence[Ranking]) -> dict[str, Any]:
    """All of it, for report.json."""
    return {"schema": 1, **set_up.as_json(), "results": [_as_json(each) for each in rankings]}


def _as_json(ranking: Ranking) -> dict[str, Any]:
    """One recording at one rate: as in the comparison's report, and the figures of the bench."""
    told = ranking.result.as_json()
    recording = ranking.result.recording
    methods = {
        method: {
            **told["methods"][method],
            **figures(judged),
            "ratios": ratios(judged, ranking.other),
        }
        for method, judged in ranking.result.judged.items()
    }
    name = recording.folder.resolve().name
    return {**told, "name": name, "every": recording.excerpt.every, "methods": methods}


def write_report(folder: Path, set_up: SetUp, rankings: Sequence[Ranking]) -> None:
    """Write the files, report.json last. Raises InputError or UserFacingError as `write_file`."""
    notes = (
        f"Methods: {', '.join(set_up.methods)}; `method` below counts where one is to be run.",
        f"--every {' '.join(map(str, set_up.every))}"
        + ("" if set_up.frames is None else f" --frames {set_up.frames}"),
    )
    config = effective_config(set_up.odometry, set_up.camera_file, set_up.listener.tables, *notes)
    write_file(folder / CONFIG, config.encode())
    write_file(folder / TABLE, bench_table(rankings).as_csv().encode())
    text = json.dumps(content_of(set_up, rankings), indent=2)
    write_file(folder / DATA, f"{text}\n".encode())
