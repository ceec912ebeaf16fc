"""SURF: Speeded-Up Robust Features, after Bay, Ess, Tuytelaars, Van Gool (CVIU 110, 2008).

Reading order as in the paper: `hessian` (box filters on the integral image), `scale_space` (layers
and octaves), `maxima` (non-maximum suppression and interpolation), `orientation`, `descriptor`, and
`extractor`, which runs them. `packed_pyramid` has the gray values for the last two steps.

`odometry` is the odometry by these features; `recovery`, `guided_matching` and `recent_views` find
the camera again where matching with the last frame fails.
"""

from vo_service.odometry.surf.extractor import Features, SurfExtractor

__all__ = ["Features", "SurfExtractor"]
