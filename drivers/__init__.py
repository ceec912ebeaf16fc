"""Cameras that deliver color and registered depth, by name. Knows nothing of odometry.

    from drivers import open_camera

    with open_camera("tum:recordings/desk") as camera:
        for frame in camera:
            print(frame.stamp_s, frame.color_bgr.shape, frame.depth_m.max())

`docs/guide/python.md` shows more. Importing this package loads no library: each name, see
`__init__.pyi`, is imported when it is first used.
"""

from drivers.core.lazy_imports import lazy_imports

__getattr__, __dir__, __all__ = lazy_imports(__name__, __file__)
