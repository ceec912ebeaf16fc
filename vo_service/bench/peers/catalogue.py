"""The peers by name: the one place where another is listed."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from platform import machine
from types import ModuleType

from vo_service.methods import FeatureSettings
from vo_service.odometry.stopwatch import Stopwatch
from vo_service.types import Odometry


@dataclass(frozen=True)
class Package:
    """A library that a peer is part of: what it is imported as, and what pip calls it."""

    module: str
    pip_names: tuple[str, ...]

    @property
    def is_installed(self) -> bool:
        """Without importing it: that may take seconds."""
        return find_spec(self.module) is not None

    @property
    def how_to_install(self) -> str:
        """A command."""
        return f"pip install {self.pip_names[0]}"

    @property
    def version(self) -> str:
        """As installed; "" where the files are there without their description."""
        for name in self.pip_names:
            try:
                return version(name)
            except PackageNotFoundError:
                continue
        return ""

    def load(self) -> ModuleType:
        """Import it."""
        return importlib.import_module(self.module)


OPENCV = Package("cv2", ("opencv-python-headless",))
# Only for x86_64 there is one without CUDA's libraries.
OPEN3D = Package("open3d", ("open3d-cpu", "open3d") if machine() == "x86_64" else ("open3d",))
SMALL_GICP = Package("small_gicp", ("small-gicp",))


@dataclass(frozen=True)
class Peer:
    """An odometry of other people's making."""

    package: Package
    make: Callable[[FeatureSettings, Stopwatch], Odometry]


def _opencv(kind: str) -> Peer:
    def make(_features: FeatureSettings, _stopwatch: Stopwatch) -> Odometry:
        import cv2

        from vo_service.bench.peers.frame_to_frame import FrameToFrame
        from vo_service.bench.peers.opencv import OpenCvOdometry

        return FrameToFrame(OpenCvOdometry(getattr(cv2, f"OdometryType_{kind}")))

    return Peer(OPENCV, make)


def _open3d_icp(_features: FeatureSettings, _stopwatch: Stopwatch) -> Odometry:
    from vo_service.bench.peers.frame_to_frame import FrameToFrame
    from vo_service.bench.peers.open3d_methods import Open3dIcp

    return FrameToFrame(Open3dIcp(OPEN3D.load()))


def _open3d_hybrid(_features: FeatureSettings, _stopwatch: Stopwatch) -> Odometry:
    from vo_service.bench.peers.frame_to_frame import FrameToFrame
    from vo_service.bench.peers.open3d_methods import Open3dHybrid

    return FrameToFrame(Open3dHybrid(OPEN3D.load()))


def _small_gicp(_features: FeatureSettings, _stopwatch: Stopwatch) -> Odometry:
    from vo_service.bench.peers.frame_to_frame import FrameToFrame
    from vo_service.bench.peers.small_gicp_method import SmallGicp

    return FrameToFrame(SmallGicp(SMALL_GICP.load()))


def _sift(features: FeatureSettings, stopwatch: Stopwatch) -> Odometry:
    from vo_service.bench.peers.features import sift_odometry

    return sift_odometry(features.count, stopwatch)


def _orb(features: FeatureSettings, stopwatch: Stopwatch) -> Odometry:
    from vo_service.bench.peers.features import orb_odometry

    return orb_odometry(features.count, stopwatch)


PEERS: Mapping[str, Peer] = {
    "cv2-rgb": _opencv("RGB"),
    "cv2-rgb-depth": _opencv("RGB_DEPTH"),
    "cv2-depth": _opencv("DEPTH"),
    "open3d-icp": Peer(OPEN3D, _open3d_icp),
    "open3d-hybrid": Peer(OPEN3D, _open3d_hybrid),
    "small-gicp": Peer(SMALL_GICP, _small_gicp),
    "sift": Peer(OPENCV, _sift),
    "orb": Peer(OPENCV, _orb),
}
