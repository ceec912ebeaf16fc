"""Versions of the software that gives a result."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

PROJECT_ROOT = Path(__file__).parents[3]
# Sources of the poses and their times besides the libraries.
SOURCES = (
    "drivers",
    "vo_service/odometry",
    "vo_service/types",
    "vo_service/tools/compare/baselines",
    "vo_service/tools/compare/runner.py",
    "vo_service/tools/compare/methods.py",
)
VERSIONED_PACKAGES = ("kinect-vo", "numpy", "opencv-python-headless", "numba")


@cache
def collect_versions() -> dict[str, str]:
    """Return versions by name; `source` is a digest of the code that makes the poses."""
    return {
        **{name: version(name) for name in VERSIONED_PACKAGES},
        "python": platform.python_version(),
        "source": digest_sources(SOURCES),
        "machine": platform.machine(),
        "processor": _processor_name(),
    }


@cache
def digest_sources(sources: tuple[str, ...]) -> str:
    """Return a digest of code and arrays in files and folders of the program."""
    digest = hashlib.sha256()
    for source in sources:
        path = PROJECT_ROOT / source
        files = [*path.rglob("*.py"), *path.rglob("*.npy")] if path.is_dir() else [path]
        for file in sorted(files):
            digest.update(f"{file.relative_to(PROJECT_ROOT)}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def _processor_name() -> str:
    """Return the processor's name; "" if not known."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return ""
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "")
