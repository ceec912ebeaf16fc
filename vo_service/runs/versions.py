"""What ran: versions, the source itself, and the computer that its times belong to."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).parents[2]
# What the poses and their times come from, beside the libraries.
SOURCES = (
    "drivers",
    "vo_service/odometry",
    "vo_service/methods.py",
    "vo_service/bench/peers",
    "vo_service/runs/diary.py",
    "vo_service/runs/following.py",
    "vo_service/runs/method_recipe.py",
    "vo_service/runs/true_scale.py",
)
PACKAGES = ("kinect-vo", "numpy", "opencv-python-headless", "numba")


@cache
def versions() -> dict[str, str]:
    """Versions by name; `source` is a digest of the code that makes the poses."""
    return {
        **{name: version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "source": _source_digest(),
        "machine": platform.machine(),
        "processor": _processor(),
    }


def _source_digest() -> str:
    digest = hashlib.sha256()
    for source in SOURCES:
        path = ROOT / source
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(f"{file.relative_to(ROOT)}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def _processor() -> str:
    """The processor's name where the kernel tells one."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return ""
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "")
