"""SURF: Speeded-Up Robust Features, after Bay, Ess, Tuytelaars, Van Gool (CVIU 110, 2008).

Reading order as in the paper: `detector` (box filters on the integral image, maxima), `extractor`
(scale space, selection of the strongest), and `descriptor` (direction and descriptor).

`odometry` is the odometry by these features; `recovery` finds the camera again where matching with
the last frame fails.
"""

from vo_service.odometry.surf.extractor import Features, SurfExtractor

__all__ = ["Features", "SurfExtractor"]
