"""Results of a reconstruction: the mesh, images of it, and a report."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from drivers.core.files import atomic_write
from drivers.core.geometry import Array
from vo_service.reconstruction.gravity_alignment import estimate_up, level_transform
from vo_service.reconstruction.mesh import Mesh, write_ply
from vo_service.reconstruction.reconstructor import ReconstructionResult
from vo_service.reconstruction.render import render_camera_view, render_overview, render_top_view
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.terminal import format_columns

MESH_FILE, REPORT_FILE = "map.ply", "reconstruction.json"
TOP_VIEW_FILE, OVERVIEW_FILE, CAMERA_VIEW_FILE = "top.png", "perspective.png", "view.png"


@dataclass(frozen=True)
class ReconstructionReport:
    """A finished map with at least one triangle.

    Attributes:
        title: Title of the top view.
        mesh: The map.
        result: Counts and poses of the frames.
        volume: The volume that the map was extracted from.
        is_interrupted: Whether it stopped before the last frame.
        loop_closure_counts: Counts of loop closure, by name; empty without loop closure.
    """

    title: str
    mesh: Mesh
    result: ReconstructionResult
    volume: TsdfVolume
    is_interrupted: bool
    loop_closure_counts: Mapping[str, int]

    @cached_property
    def T_level_world(self) -> Array:
        """4x4 transform to level axes: x right and y forward of the first camera, z up."""
        up = estimate_up(self.mesh, self.result.up_direction.up)
        return level_transform(self.result.poses[0], up)

    @cached_property
    def size_m(self) -> tuple[float, float, float]:
        """Extent of the map to the right, forward and up."""
        level_m = self.mesh.vertices_m @ self.T_level_world[:3, :3].T
        right_m, forward_m, up_m = (float(side) for side in np.ptp(level_m, axis=0))
        return right_m, forward_m, up_m

    def save(self, folder: Path, report_progress: Callable[[str], None]) -> None:
        """Write all files, each atomically, the report last.

        Args:
            folder: An existing folder.
            report_progress: Called with each file's name before it is written.

        Raises:
            WriteError: A file cannot be written.
        """
        mesh, camera, poses = self.mesh, self.result.camera, self.result.poses
        assert camera is not None  # that of a frame in the map
        report_progress(MESH_FILE)
        write_ply(folder / MESH_FILE, mesh)
        pictures: dict[str, Callable[[], bytes]] = {
            TOP_VIEW_FILE: lambda: render_top_view(
                mesh, self.T_level_world, self.result.trajectory_m, self.title
            ),
            OVERVIEW_FILE: lambda: render_overview(mesh, self.T_level_world),
            CAMERA_VIEW_FILE: lambda: render_camera_view(mesh, camera, poses[0]),
            REPORT_FILE: lambda: f"{json.dumps(self.as_json(), indent=2)}\n".encode(),
        }
        for name, draw in pictures.items():
            report_progress(name)
            atomic_write(folder / name, draw())

    def as_json(self) -> dict[str, Any]:
        """Return the report as one flat JSON object."""
        result, config = self.result, self.volume.config
        return {
            "frames": result.frames,
            "fused": result.fused,
            "without_pose": result.without_pose,
            "without_depth": result.without_depth,
            "vertices": len(self.mesh.vertices_m),
            "triangles": len(self.mesh.triangles),
            "size_m": [round(side, 3) for side in self.size_m],
            "voxel_m": config.voxel_m,
            "max_depth_m": config.max_depth_m,
            "memory_mb": config.memory_mb,
            "memory_used": round(self.volume.used_fraction, 4),
            "full_at_frame": result.full_at_frame or None,
            "cut_short": self.is_interrupted,
            **self.loop_closure_counts,
        }

    def as_table(self) -> str:
        """Format the report as aligned text, without a final newline."""
        result, config = self.result, self.volume.config
        right_m, forward_m, up_m = self.size_m
        memory = f"{self.volume.used_fraction:.0%} of {config.memory_mb} MB"
        if result.full_at_frame:
            memory += f", full at frame {result.full_at_frame}"
        rows = [
            ("frames", f"{result.frames}"),
            ("in the map", f"{result.fused}"),
            ("skipped, no good pose", f"{result.without_pose}"),
            ("skipped, no depth", f"{result.without_depth}"),
            ("size", f"{right_m:.2f} m right, {forward_m:.2f} m forward, {up_m:.2f} m up"),
            ("triangles", f"{len(self.mesh.triangles)}, voxels of {config.voxel_m:g} m"),
            ("memory", memory),
        ]
        rows += [(name, f"{count}") for name, count in self.loop_closure_counts.items()]
        return format_columns(rows)
