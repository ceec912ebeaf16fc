"""Versions of Python and of the libraries that the poses depend on."""

import platform
from importlib.metadata import version


def versions() -> dict[str, str]:
    """Return the versions by name."""
    packages = ("kinect-vo", "eclipse-zenoh", "numpy", "numba", "opencv-python-headless")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}
