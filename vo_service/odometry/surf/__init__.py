"""SURF: Speeded-Up Robust Features, after Bay, Ess, Tuytelaars, Van Gool (CVIU 110, 2008).

Reads in the paper's order: `hessian` (box filters on the integral image), `scale_space` (layers and
octaves), `maxima` (non-maximum suppression and interpolation), `orientation`, `descriptor`, and
`extractor`, which runs them. `pyramid` holds the gray values that the last two steps sample.
"""

from vo_service.odometry.surf.extractor import Features, SurfExtractor

__all__ = ["Features", "SurfExtractor"]
