"""Further outputs by name: those of installed plug-ins, and the trajectory file.

An output is a function in the entry-point group `kinect_vo.outputs`. It gets its argument and the
playback mode, and opens the output. Outputs that take commands or show addresses (Zenoh, Rerun, the
recorder and the mapper) have tables of their own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from drivers.camera import PlaybackMode
from drivers.core.plugins import PluginGroup
from vo_service.types import Output

OUTPUTS: PluginGroup[Callable[[str, PlaybackMode], Output]] = PluginGroup(
    "kinect_vo.outputs", "output", ("trajectory",)
)


@dataclass(frozen=True)
class ExtraOutputsConfig:
    """`[outputs]`: further outputs."""

    extra: Annotated[
        tuple[str, ...], "any of: trajectory:FILE, or NAME[:ARGUMENT] of a plug-in"
    ] = ()

    def __post_init__(self) -> None:
        for output in self.extra:
            if output.partition(":")[0] not in OUTPUTS:
                raise ValueError(f"extra {output!r} is unknown; use one of {', '.join(OUTPUTS)}")
