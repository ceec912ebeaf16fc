"""The map of places as it is drawn. Imports rerun: for the viewer's process alone."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vo_service.viewer.blueprint import MAP
from vo_service.viewer.messages import Corrected, Graph

MAP_COLOUR = (60, 210, 200)
LOOP_COLOUR = (230, 80, 210)
# What has not changed is drawn again after this many pictures, for a viewer that comes late.
PICTURES_PER_MAP = 100


class MapDrawing:
    """Places, what joins them, and the stretch from the newest to where the camera is now."""

    def __init__(self, stream: rr.RecordingStream, graph: Graph) -> None:
        """`graph` is what is there already."""
        self._stream = stream
        self._graph = graph
        self._pictures = PICTURES_PER_MAP  # at once

    def draw(self, graph: Graph) -> None:
        """Another map than before."""
        self._graph = graph
        self._draw()

    def next_picture(self) -> None:
        """Draw it again if it is time."""
        self._pictures += 1
        if self._pictures >= PICTURES_PER_MAP and len(self._graph.positions):
            self._draw()

    def go_on(self, corrected: Corrected) -> None:
        """The camera has moved on."""
        if len(self._graph.positions):
            stretch = np.stack([self._graph.positions[-1], corrected.position])
            self._log_lines("latest", stretch[None].astype(np.float32), MAP_COLOUR)

    def _draw(self) -> None:
        graph = self._graph
        self._pictures = 0
        places = rr.Points3D(graph.positions, colors=MAP_COLOUR, radii=rr.Radius.ui_points(4.0))
        self._stream.log(f"{MAP}/places", places)
        self._log_lines("motions", graph.motions, MAP_COLOUR)
        self._log_lines("loops", graph.loops, LOOP_COLOUR)

    def _log_lines(
        self, part: str, lines: NDArray[np.float32], colour: tuple[int, int, int]
    ) -> None:
        strips = rr.LineStrips3D(lines, colors=colour, radii=rr.Radius.ui_points(1.0))
        self._stream.log(f"{MAP}/{part}", strips)
