"""Reading the configuration again while the service runs: what may change at once, and what waits.

`Reloader.reload` reads files: call it from the main thread, never from the loop's.
"""

import dataclasses
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from drivers.errors import UserFacingError
from vo_service.config import Config

# What somebody applies while the service runs; everything else takes effect at the next start.
LIVE_KEYS = (
    "sensor.led",
    "sensor.tilt_deg",
    "odometry.feature_count",
    "commands.per_second",
    "recorder.save_on_loss",
    "recorder.total_mb",
    "map.max_mb",
    "map.voxel_m",
    "map.making_mb",
    "map.total_mb",
    "load.adapt",
    "load.min_features",
    "log.level",
)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Changes:
    """What a configuration that was read again changes.

    config   what counts from now on: the one before, with the `live` keys as they are wanted
    live     keys of LIVE_KEYS, such as "sensor.led", that have a new value now
    pending  keys that differ from what runs and will count from the next start on
    """

    config: Config
    live: tuple[str, ...] = ()
    pending: tuple[str, ...] = ()


def changes_between(running: Config, wanted: Config) -> Changes:
    """What to do at once, and what cannot be done, to get from one to the other."""
    keys = tuple(_differences(running, wanted, ""))
    live = tuple(key for key in keys if key in LIVE_KEYS)
    config = running
    for key in live:
        config = _with_key(config, wanted, key)
    return Changes(config, live, tuple(key for key in keys if key not in LIVE_KEYS))


class Reloader:
    """The configuration that counts, and reading it again.

    `warning` is a clause for the status: "" while the file could be read the last time.
    """

    def __init__(self, running: Config, read: Callable[[], Config]) -> None:
        """`read` gives the configuration as at a start, command line included, or raises."""
        self.config = running
        self.warning = ""
        self._read = read

    def reload(self) -> Changes:
        """Read again. A file that is broken is logged and changes nothing."""
        try:
            wanted = self._read()
        except UserFacingError as error:
            self.warning = f"the configuration is not the one in the file: {error}"
            logger.error("%s; what was read before still counts", error)
            return Changes(self.config)
        self.warning = ""
        changes = changes_between(self.config, wanted)
        self.config = changes.config
        self._log(changes)
        return changes

    @staticmethod
    def _log(changes: Changes) -> None:
        if changes.pending:
            ending = "takes effect" if len(changes.pending) == 1 else "take effect"
            keys = ", ".join(changes.pending)
            logger.warning("%s changed: %s at the next start", keys, ending)
        logger.info("configuration read again; changed now: %s", ", ".join(changes.live) or "none")


def _differences(one: Any, other: Any, prefix: str) -> Iterator[str]:
    """Dotted keys of the values that are not equal; a list is one value."""
    for field in dataclasses.fields(one):
        key = f"{prefix}{field.name}"
        before, after = getattr(one, field.name), getattr(other, field.name)
        if dataclasses.is_dataclass(before) and dataclasses.is_dataclass(after):
            yield from _differences(before, after, f"{key}.")
        elif before != after:
            yield key


def _with_key(config: Config, wanted: Config, key: str) -> Config:
    """`config` with one key, ``table.key``, as it is in `wanted`."""
    table, _, name = key.partition(".")
    value = getattr(getattr(wanted, table), name)
    changed: dict[str, Any] = {table: replace(getattr(config, table), **{name: value})}
    return replace(config, **changed)
