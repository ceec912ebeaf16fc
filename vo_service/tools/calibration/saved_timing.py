"""What ``kinect-vo calibrate`` prints after it has saved a timing."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from vo_service.tools.calibration.timing import SensorTiming


@dataclass(frozen=True)
class SavedTiming:
    """Timings, of which the last one is in a camera file now.

    Attributes:
        source: By name: where the values come from.
        values: By heading: a timing.
        backup: The file before; None without one.
    """

    source: Mapping[str, object]
    values: Mapping[str, SensorTiming]
    file: Path
    backup: Path | None

    @property
    def _keys(self) -> tuple[str, ...]:
        return tuple(next(iter(self.values.values())))

    def as_json(self) -> dict[str, object]:
        """Return one JSON object; the keys are stable."""
        backup = None if self.backup is None else str(self.backup)
        numbers = {
            key: {heading: asdict(timing[key]) for heading, timing in self.values.items()}
            for key in self._keys
        }
        return {"camera_file": str(self.file), "kept": backup} | dict(self.source) | numbers

    def as_table(self) -> str:
        """Format the source, a line for each value, and the file."""
        lines = [", ".join(f"{name}: {value}" for name, value in self.source.items()), ""]
        lines.append(f"{'':<16}" + "".join(f"{heading:>18}" for heading in self.values))
        for key in self._keys:
            times = "".join(f"{timing[key]!s:>18}" for timing in self.values.values())
            lines.append(f"{key:<16}{times}")
        before = f"; the one before is {self.backup.name}" if self.backup else ""
        return "\n".join([*lines, f"\nsaved in {self.file}{before}"])
