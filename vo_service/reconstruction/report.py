"""What a reconstruction leaves behind: the map, pictures of it, and its figures."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera import PinholeCamera
from drivers.core.errors import UserFacingError
from drivers.core.files import atomic_write, is_disk_full
from drivers.core.geometry import Array
from vo_service.reconstruction.gravity_alignment import estimate_up, level_transform
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.pictures import render_camera_view, render_overview, render_top_view
from vo_service.reconstruction.ply import write_ply
from vo_service.reconstruction.reconstructor import ReconstructionResult
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.text_table import format_columns

MESH_FILE, REPORT_FILE = "map.ply", "reconstruction.json"
TOP_VIEW_FILE, OVERVIEW_FILE, CAMERA_VIEW_FILE = "top.png", "perspective.png", "view.png"


@dataclass(frozen=True)
class ReconstructionReport:
    """A map that is done, with one triangle at least.

    title         over the view from above
    camera        intrinsics of the frames
    is_cut_short  stopped before the last frame
    of_places     how many places and loops have corrected the poses; empty where none were asked
    """

    title: str
    camera: PinholeCamera
    mesh: Mesh
    result: ReconstructionResult
    volume: TsdfVolume
    is_interrupted: bool
    loop_closure_counts: Mapping[str, int] = field(default_factory=dict)

    @cached_property
    def T_level_world(self) -> Array:
        """4x4: x right and y forward as seen by the first camera, z up."""
        up = estimate_up(self.mesh, self.result.up_direction.up)
        return level_transform(self.result.poses[0], up)

    @cached_property
    def size_m(self) -> tuple[float, float, float]:
        """Extent of the map: to the right, forward and up."""
        level_m = self.mesh.vertices_m @ self.T_level_world[:3, :3].T
        right_m, forward_m, up_m = (float(side) for side in np.ptp(level_m, axis=0))
        return right_m, forward_m, up_m

    def save(self, folder: Path, report_progress: Callable[[str], None]) -> None:
        """Write everything, each file whole, the report last; `tell` gets each file's name before.

        Raises UserFacingError if the disk refuses.
        """
        mesh, poses = self.mesh, self.result.poses
        report_progress(MESH_FILE)
        with translate_write_errors(folder / MESH_FILE):
            write_ply(folder / MESH_FILE, mesh)
        pictures: dict[str, Callable[[], bytes]] = {
            TOP_VIEW_FILE: lambda: render_top_view(
                mesh, self.T_level_world, self.result.trajectory_m, self.title
            ),
            OVERVIEW_FILE: lambda: render_overview(mesh, self.T_level_world),
            CAMERA_VIEW_FILE: lambda: render_camera_view(mesh, self.camera, poses[0]),
            REPORT_FILE: lambda: f"{json.dumps(self.as_json(), indent=2)}\n".encode(),
        }
        for name, draw in pictures.items():
            report_progress(name)
            with translate_write_errors(folder / name):
                atomic_write(folder / name, draw())

    def as_json(self) -> dict[str, Any]:
        """One flat object."""
        harvest, settings = self.result, self.volume.config
        return {
            "frames": harvest.frames,
            "fused": harvest.fused,
            "without_pose": harvest.without_pose,
            "without_depth": harvest.without_depth,
            "vertices": len(self.mesh.vertices_m),
            "triangles": len(self.mesh.triangles),
            "size_m": [round(side, 3) for side in self.size_m],
            "voxel_m": settings.voxel_m,
            "max_depth_m": settings.max_depth_m,
            "memory_mb": settings.memory_mb,
            "memory_used": round(self.volume.used_fraction, 4),
            "full_at_frame": harvest.full_at_frame or None,
            "cut_short": self.is_interrupted,
            **self.loop_closure_counts,
        }

    def as_table(self) -> str:
        """Aligned text for a terminal, without a newline at its end."""
        harvest, settings = self.result, self.volume.config
        right_m, forward_m, up_m = self.size_m
        used = f"{self.volume.used_fraction:.0%} of {settings.memory_mb} MB"
        rows = [
            ("frames", f"{harvest.frames}"),
            ("in the map", f"{harvest.fused}"),
            ("left out, no good pose", f"{harvest.without_pose}"),
            ("left out, no depth", f"{harvest.without_depth}"),
            ("size", f"{right_m:.2f} m right, {forward_m:.2f} m forward, {up_m:.2f} m up"),
            ("triangles", f"{len(self.mesh.triangles)}, voxels of {settings.voxel_m:g} m"),
            (
                "memory",
                used
                + (f", full at frame {harvest.full_at_frame}" if harvest.full_at_frame else ""),
            ),
        ]
        rows += [(name, f"{count}") for name, count in self.loop_closure_counts.items()]
        return format_columns(rows)


@contextmanager
def translate_write_errors(path: Path) -> Iterator[None]:
    """What the disk refuses in the block, as one line."""
    try:
        yield
    except OSError as error:
        cause = "the disk is full" if is_disk_full(error) else error.strerror
        raise UserFacingError(f"{path}: cannot be written: {cause}; mend that and run again") from (
            error
        )
