"""Reading the configuration again while the service runs: what may change at once, and what waits.

`ConfigReloader.reload` reads files: call it from the main thread, never from the loop's.
"""

import dataclasses
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from drivers.core.errors import UserFacingError
from vo_service.config import Config

# What somebody applies while the service runs; everything else takes effect at the next start.
RELOADABLE_KEYS = (
    "sensor.led",
    "sensor.tilt_deg",
    "odometry.feature_count",
    "commands.per_second",
    "recorder.save_on_loss",
    "recorder.total_mb",
    "map.max_mb",
    "map.voxel_m",
    "map.mesh_memory_mb",
    "map.total_mb",
    "load.adapt",
    "load.min_features",
    "log.level",
)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ConfigChanges:
    """What a configuration that was read again changes.

    config   what counts from now on: the one before, with the `live` keys as they are wanted
    live     keys of LIVE_KEYS, such as "sensor.led", that have a new value now
    pending  keys that differ from what runs and will count from the next start on
    """

    config: Config
    reloaded_keys: tuple[str, ...] = ()
    pending_keys: tuple[str, ...] = ()


def diff_configs(running: Config, requested: Config) -> ConfigChanges:
    """What to do at once, and what cannot be done, to get from one to the other."""
    keys = tuple(_changed_keys(running, requested, ""))
    live = tuple(key for key in keys if key in RELOADABLE_KEYS)
    config = running
    for key in live:
        config = _replace_key(config, requested, key)
    return ConfigChanges(config, live, tuple(key for key in keys if key not in RELOADABLE_KEYS))


class ConfigReloader:
    """The configuration that counts, and reading it again.

    `warning` is a clause for the status: "" while the file could be read the last time.
    """

    def __init__(self, running: Config, read: Callable[[], Config]) -> None:
        """`read` gives the configuration as at a start, command line included, or raises."""
        self.config = running
        self.warning = ""
        self._read = read

    def reload(self) -> ConfigChanges:
        """Read again. A file that is broken is logged and changes nothing."""
        try:
            wanted = self._read()
        except UserFacingError as error:
            self.warning = f"the configuration is not the one in the file: {error}"
            logger.error("%s; what was read before still counts", error)
            return ConfigChanges(self.config)
        self.warning = ""
        changes = diff_configs(self.config, wanted)
        self.config = changes.config
        self._log(changes)
        return changes

    @staticmethod
    def _log(changes: ConfigChanges) -> None:
        if changes.pending_keys:
            ending = "takes effect" if len(changes.pending_keys) == 1 else "take effect"
            keys = ", ".join(changes.pending_keys)
            logger.warning("%s changed: %s at the next start", keys, ending)
        logger.info(
            "configuration read again; changed now: %s", ", ".join(changes.reloaded_keys) or "none"
        )


def _changed_keys(one: Any, other: Any, prefix: str) -> Iterator[str]:
    """Dotted keys of the values that are not equal; a list is one value."""
    for field in dataclasses.fields(one):
        key = f"{prefix}{field.name}"
        before, after = getattr(one, field.name), getattr(other, field.name)
        if dataclasses.is_dataclass(before) and dataclasses.is_dataclass(after):
            yield from _changed_keys(before, after, f"{key}.")
        elif before != after:
            yield key


def _replace_key(config: Config, requested: Config, key: str) -> Config:
    """`config` with one key, ``table.key``, as it is in `wanted`."""
    table, _, name = key.partition(".")
    value = getattr(getattr(requested, table), name)
    changed: dict[str, Any] = {table: replace(getattr(config, table), **{name: value})}
    return replace(config, **changed)
