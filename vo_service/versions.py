"""Versions of what makes the poses."""

import platform
from importlib.metadata import version


def versions() -> dict[str, str]:
    """Versions by name, of Python and of the libraries that make the poses."""
    packages = ("kinect-vo", "eclipse-zenoh", "numpy", "numba", "opencv-python-headless")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}
