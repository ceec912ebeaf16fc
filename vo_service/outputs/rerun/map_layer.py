"""Drawing of the keyframe map. Imports rerun: only for the viewer's process."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vo_service.outputs.rerun.blueprint import MAP
from vo_service.outputs.rerun.messages import CorrectedPosition, MapGraph

MAP_COLOR = (60, 210, 200)
LOOP_COLOR = (230, 80, 210)
# An unchanged map is drawn again after this many images, for a viewer that connects late.
IMAGES_PER_MAP_REDRAW = 100


class MapLayer:
    """Keyframes, their edges, and a line from the newest keyframe to the camera."""

    def __init__(self, stream: rr.RecordingStream, graph: MapGraph) -> None:
        """Start with an existing map."""
        self._stream = stream
        self._graph = graph
        self._images_since_redraw = IMAGES_PER_MAP_REDRAW  # at once

    def set_graph(self, graph: MapGraph) -> None:
        """Draw a new map."""
        self._graph = graph
        self._log_graph()

    def on_image(self) -> None:
        """Draw the map again if it is due."""
        self._images_since_redraw += 1
        if self._images_since_redraw >= IMAGES_PER_MAP_REDRAW and len(self._graph.positions):
            self._log_graph()

    def extend_to(self, corrected: CorrectedPosition) -> None:
        """Draw the line from the newest keyframe to the camera."""
        if len(self._graph.positions):
            line = np.stack([self._graph.positions[-1], corrected.position])
            self._log_lines("latest", line[None].astype(np.float32), MAP_COLOR)

    def _log_graph(self) -> None:
        graph = self._graph
        self._images_since_redraw = 0
        keyframes = rr.Points3D(graph.positions, colors=MAP_COLOR, radii=rr.Radius.ui_points(4.0))
        self._stream.log(f"{MAP}/keyframes", keyframes)
        self._log_lines("odometry_edges", graph.odometry_edges, MAP_COLOR)
        self._log_lines("loop_closures", graph.loop_edges, LOOP_COLOR)

    def _log_lines(
        self, part: str, lines: NDArray[np.float32], color: tuple[int, int, int]
    ) -> None:
        strips = rr.LineStrips3D(lines, colors=color, radii=rr.Radius.ui_points(1.0))
        self._stream.log(f"{MAP}/{part}", strips)
