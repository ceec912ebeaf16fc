"""Preview of a growing map in Rerun. Imports rerun: load it lazily."""

import rerun as rr
import rerun.blueprint as rrb

from vo_service.reconstruction.reconstructor import PreviewFrame, PreviewMap

WORLD, SURFACE, TRAJECTORY, CAMERA = "world", "world/surface", "world/path", "world/camera"
TRAJECTORY_COLOR = (255, 150, 40)
TIMELINE = "frame"
FRUSTUM_M = 0.2


class ReconstructionScene:
    """Logs preview frames to one recording stream."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._logged_map: PreviewMap | None = None
        # Optical axes: x right, y down, z forward.
        stream.log(WORLD, rr.ViewCoordinates.RDF, static=True)

    @staticmethod
    def blueprint() -> rrb.Blueprint:
        """Make a layout in which the map fills the window."""
        return rrb.Blueprint(
            rrb.Spatial3DView(name="Surface and camera trajectory", origin=WORLD),
            rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            auto_views=False,
        )

    def log(self, frame: PreviewFrame) -> None:
        """Log the camera, and the trajectory and surface if they are new."""
        stream, camera, T = self._stream, frame.camera, frame.T_world_camera
        stream.set_time(TIMELINE, sequence=frame.seq)
        stream.log(CAMERA, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        pinhole = rr.Pinhole(
            image_from_camera=camera.K,
            resolution=[camera.width, camera.height],
            image_plane_distance=FRUSTUM_M,
        )
        stream.log(CAMERA, pinhole)
        if frame.preview_map is not self._logged_map:
            self._logged_map = frame.preview_map
            mesh, trajectory_m = frame.preview_map.mesh, frame.preview_map.trajectory_m
            stream.log(TRAJECTORY, rr.LineStrips3D([trajectory_m], colors=TRAJECTORY_COLOR))
            surface = rr.Mesh3D(
                vertex_positions=mesh.vertices_m,
                vertex_normals=mesh.normals,
                vertex_colors=mesh.colors_rgb,
                triangle_indices=mesh.triangles,
            )
            stream.log(SURFACE, surface)
