"""What ran: versions, the source itself, and the computer that its times belong to."""

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

PROJECT_ROOT = Path(__file__).parents[3]
# What the poses and their times come from, beside the libraries.
SOURCES = (
    "drivers",
    "vo_service/odometry",
    "vo_service/types",
    "vo_service/tools/benchmark/baselines",
    "vo_service/tools/benchmark/run_recorder.py",
    "vo_service/tools/benchmark/runner.py",
    "vo_service/tools/benchmark/method_factory.py",
    "vo_service/tools/benchmark/reference_scale.py",
)
VERSIONED_PACKAGES = ("kinect-vo", "numpy", "opencv-python-headless", "numba")


@cache
def collect_versions() -> dict[str, str]:
    """Versions by name; `source` is a digest of the code that makes the poses."""
    return {
        **{name: version(name) for name in VERSIONED_PACKAGES},
        "python": platform.python_version(),
        "source": digest_sources(SOURCES),
        "machine": platform.machine(),
        "processor": _processor_name(),
    }


@cache
def digest_sources(sources: tuple[str, ...]) -> str:
    """Of files and folders of the program: its code, and the arrays that are kept with it."""
    digest = hashlib.sha256()
    for source in sources:
        path = PROJECT_ROOT / source
        files = [*path.rglob("*.py"), *path.rglob("*.npy")] if path.is_dir() else [path]
        for file in sorted(files):
            digest.update(f"{file.relative_to(PROJECT_ROOT)}\n".encode() + file.read_bytes())
    return digest.hexdigest()[:16]


def _processor_name() -> str:
    """The processor's name where the kernel tells one."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return ""
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "")
