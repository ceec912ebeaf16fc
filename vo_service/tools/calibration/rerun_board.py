"""Preview of a live calibration in Rerun. Imports rerun: load it lazily."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from drivers.recording.image_encoding import encode_jpeg
from vo_service.tools.calibration.collect_live import BoardPreviewFrame
from vo_service.tools.calibration.view_selection import convex_outline

IMAGE_PATH, CORNERS_PATH, VIEWS_PATH, ADVICE_PATH = (
    "image",
    "image/corners",
    "image/taken",
    "advice",
)
CORNER_COLOR = (255, 150, 40)
VIEW_COLOR = (40, 220, 130)
TIMELINE = "snapshot"
JPEG_QUALITY = 80


class BoardScene:
    """Logger of preview frames to one recording stream."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._seq = 0

    @staticmethod
    def blueprint() -> rrb.Blueprint:
        """Return the layout: the instruction above the image."""
        return rrb.Blueprint(
            rrb.Vertical(
                rrb.TextDocumentView(name="What to do", origin=ADVICE_PATH),
                rrb.Spatial2DView(name="Camera image; accepted views in green", origin=IMAGE_PATH),
                row_shares=[1, 8],
            ),
            rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            auto_views=False,
        )

    def log(self, item: BoardPreviewFrame) -> None:
        """Log the image, its corners, the outlines of the accepted views, and the instruction."""
        stream = self._stream
        stream.set_time(TIMELINE, sequence=self._seq)
        self._seq += 1
        jpeg = encode_jpeg(item.snapshot.color_bgr, JPEG_QUALITY)
        stream.log(IMAGE_PATH, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        # Pixel centers in Rerun are at one half.
        points = rr.Points2D(
            item.corners.pixels + 0.5, colors=CORNER_COLOR, radii=rr.Radius.ui_points(3.0)
        )
        stream.log(CORNERS_PATH, points)
        hulls = [convex_outline(view.corners.pixels) for view in item.views]
        outlines = [np.vstack([hull, hull[:1]]) for hull in hulls]
        lines = rr.LineStrips2D(outlines, colors=VIEW_COLOR, radii=rr.Radius.ui_points(1.0))
        stream.log(VIEWS_PATH, lines)
        stream.log(ADVICE_PATH, rr.TextDocument(f"# {item.advice}", media_type="text/markdown"))
