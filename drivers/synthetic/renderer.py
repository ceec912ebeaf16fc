"""Render a frame of the virtual Kinect, from the exact motion to the images of the driver."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, rigid_transform
from drivers.rectify import Undistorter
from drivers.synthetic import sensors
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.dynamic_objects import DynamicObject, make_dynamic_objects
from drivers.synthetic.lighting import make_lights
from drivers.synthetic.motions import make_motion
from drivers.synthetic.raycast import RaycastScene, RayGrid, cast_rays, prepare_scene
from drivers.synthetic.room import ROOM_HEIGHT_M, build_room, symmetrize_lights
from drivers.synthetic.sensors import RenderedImages
from drivers.synthetic.shading import shade, smooth_edges
from drivers.synthetic.solids import SolidArrays
from drivers.synthetic.texture_atlas import TextureAtlas, paint_atlas

CLEARANCE_CHECKS_PER_S = 10


@dataclass(frozen=True)
class RoomModel:
    """The solids of a room, their painted textures, and the moving objects."""

    solids: SolidArrays
    atlas: TextureAtlas
    dynamic_objects: Sequence[DynamicObject]

    @classmethod
    def build(
        cls,
        config: SyntheticConfig,
        motion: CameraMotion,
        threads: int,
        folder: FilePath | None = None,
    ) -> "RoomModel":
        """Build the room of `config`, without furniture in the way of the camera or moving objects.

        Moving objects are lit once, for their position halfway, and cast no shadow.

        Args:
            threads: Number of threads that paint the textures.
            folder: Folder for the textures; None: in memory.
        """
        checks = max(2, int(config.duration_s * CLEARANCE_CHECKS_PER_S))
        times_s = np.linspace(0.0, config.duration_s, checks)
        dynamic_objects = make_dynamic_objects(config, motion)
        clearance_points_m = np.concatenate(
            [
                motion.clearance_points_m(times_s),
                *(moving.clearance_points_m(times_s) for moving in dynamic_objects),
            ]
        )
        solids = build_room(config.seed, clearance_points_m, config.bare_wall, config.twin_corners)
        lights = make_lights(np.random.default_rng([config.seed, 4]), solids[0].half_m)
        if config.twin_corners:
            lights = symmetrize_lights(lights)
        all_solids = [
            *solids,
            *(s for moving in dynamic_objects for s in moving.solids_at_midpoint),
        ]
        occluders = SolidArrays.pack(solids)
        atlas = paint_atlas(
            all_solids, occluders, lights, config.texel_m, config.seed, threads, folder
        )
        arrays = SolidArrays.pack(solids, *(moving.solids for moving in dynamic_objects))
        return cls(arrays, atlas, dynamic_objects)

    def poses_in_bodies(self, times_s: Array, T_world_camera: Array) -> Array:
        """Express camera poses in each body's frame: the room's, then each moving object's.

        Args:
            times_s: Times (N,) of the poses.
            T_world_camera: Camera poses (N, 4, 4).

        Returns:
            T_body_camera (B, N, 4, 4).
        """
        T_object_camera = [
            np.linalg.inv(moving.poses(times_s)) @ T_world_camera for moving in self.dynamic_objects
        ]
        return np.stack([T_world_camera, *T_object_camera])


def make_renderer(
    config: SyntheticConfig, threads: int, folder: FilePath | None = None
) -> "Renderer":
    """Build the motion and the room of `config`, and their renderer.

    Args:
        folder: Where the textures are stored; see `paint_atlas`.

    Raises:
        InputError: The track cannot be used.
    """
    motion = make_motion(config, ROOM_HEIGHT_M)
    return Renderer(config, motion, RoomModel.build(config, motion, threads, folder))


@dataclass(frozen=True)
class NoiselessFrame:
    """The input of the sensors for one frame, before noise.

    Attributes:
        light_bgr: (H, W, 3) light on the color sensor, with the lens's distortion.
        depth_m: (H, W) true depth of the depth sensor.
        gain: Exposure gain of the color image.
    """

    light_bgr: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    gain: float


class Renderer:
    """Renders a sensor moving through a room. It is safe to use from many threads."""

    def __init__(self, config: SyntheticConfig, motion: CameraMotion, room: RoomModel) -> None:
        self._config = config
        self._motion = motion
        self._room = room
        camera, sensor = config.camera, config.depth
        self._distortion = np.array(config.color.distortion)
        self._undistort = Undistorter(camera, config.color.distortion)
        self._color_grid = RayGrid.from_rays(pixel_rays(camera, self._distortion))
        self._infrared = sensors.infrared_camera(sensor, camera)
        self._depth_grid, offset_m = self._color_grid, 0.0
        if sensor.registration:
            self._depth_grid = RayGrid.from_rays(pixel_rays(self._infrared, np.zeros(5)))
            offset_m = sensor.eye_offset_m
        self._T_color_depth = rigid_transform(np.eye(3), (-offset_m, 0.0, 0.0))
        self._vignette = sensors.vignetting_map(camera, config.color.vignetting)

    def render(self, index: int) -> RenderedImages:
        """Render frame `index`; the bytes are the same in every run and process."""
        rng = np.random.default_rng([self._config.seed, 5, index])
        return self.apply_sensor_noise(self.render_noiseless(index), rng)

    def render_depth(self, index: int) -> NDArray[np.uint16]:
        """Render only the depth of frame `index`, with other noise than that of `render`."""
        true_m = self._render_depth(index / self._config.rate_hz + self._config.timing.skew_s)
        rng = np.random.default_rng([self._config.seed, 6, index])
        return self._undistort.undistort_depth(self._measure_depth(true_m, rng))

    def render_noiseless(self, index: int) -> NoiselessFrame:
        """Render frame `index` without sensor noise."""
        stamp_s, config = index / self._config.rate_hz, self._config
        return NoiselessFrame(
            light_bgr=self._render_color(stamp_s),
            depth_m=self._render_depth(stamp_s + config.timing.skew_s),
            gain=sensors.gain_at(config.color, stamp_s, config.duration_s),
        )

    def apply_sensor_noise(
        self, noiseless: NoiselessFrame, rng: np.random.Generator
    ) -> RenderedImages:
        """Add the sensor's noise, drawn from `rng`."""
        sensor = self._config.color
        color = sensors.expose(noiseless.light_bgr, noiseless.gain, self._vignette, sensor, rng)
        depth = self._measure_depth(noiseless.depth_m, rng)
        return RenderedImages(
            self._undistort.undistort_color(color), self._undistort.undistort_depth(depth)
        )

    def _row_times(self, middle_s: float) -> Array:
        height = self._config.camera.height
        return middle_s + self._config.timing.readout_s * (np.arange(height) / (height - 1) - 0.5)

    def _render_color(self, stamp_s: float) -> NDArray[np.float32]:
        config, rays, times_s = self._config, self._color_grid.rays, self._row_times(stamp_s)
        T_body_row = self._poses_in_bodies(times_s)
        view = prepare_scene(self._room.solids, self._color_grid, T_body_row)
        depth_m, solid = cast_rays(rays, view.kind, view.frames, view.candidates, view.near_m)
        image = self._shade(view, depth_m, solid)
        if config.color.exposure_s == 0:
            return image
        half_s, body = config.color.exposure_s / 2, self._room.solids.body[solid]
        T_opening_now = np.linalg.inv(self._poses_in_bodies(times_s - half_s)) @ T_body_row
        T_closing_now = np.linalg.inv(self._poses_in_bodies(times_s + half_s)) @ T_body_row
        return sensors.motion_blur(
            image, rays, depth_m, body, T_opening_now, T_closing_now, config.camera.fx
        )

    def _poses_in_bodies(self, times_s: Array) -> Array:
        """T_body_camera (B, N, 4, 4) at `times_s` (N,)."""
        return self._room.poses_in_bodies(times_s, self._motion.poses(times_s))

    def _shade(
        self, view: RaycastScene, depth_m: NDArray[np.float32], solid: NDArray[np.int32]
    ) -> NDArray[np.float32]:
        atlas, rays, pixel = self._room.atlas, self._color_grid.rays, 1.0 / self._config.camera.fx
        image, surface = shade(
            rays, depth_m, solid, view.kind, view.frames, atlas.texels, atlas.levels, pixel
        )
        if self._config.color.smooth_edges:
            smooth_edges(
                image,
                surface,
                rays,
                view.kind,
                view.frames,
                view.candidates,
                view.near_m,
                atlas.texels,
                atlas.levels,
                pixel,
            )
        return image

    def _render_depth(self, middle_s: float) -> NDArray[np.float32]:
        """Depth (H, W) from the infrared camera; without registration, from the color camera."""
        T_body_row = self._poses_in_bodies(self._row_times(middle_s)) @ self._T_color_depth
        grid = self._depth_grid
        view = prepare_scene(self._room.solids, grid, T_body_row)
        return cast_rays(grid.rays, view.kind, view.frames, view.candidates, view.near_m)[0]

    def _measure_depth(
        self, true_m: NDArray[np.float32], rng: np.random.Generator
    ) -> NDArray[np.uint16]:
        config, sensor, camera = self._config, self._config.depth, self._config.camera
        measured_m = sensors.measure_depth(true_m, sensor, rng)
        if not sensor.registration:
            readings = np.minimum(measured_m * np.float32(config.depth_factor), 65535)
            depth: NDArray[np.uint16] = np.rint(readings).astype(np.uint16)
            return depth
        return sensors.register_depth(
            measured_m,
            (self._infrared.fx, self._infrared.cx, self._infrared.cy),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            self._distortion,
            sensor.eye_offset_m,
            config.depth_factor,
        )


def pixel_rays(camera: PinholeCamera, distortion: Array) -> Array:
    """Compute the rays (H, W, 2) on the plane z = 1 of the pixels of the raw, distorted image."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rays = cv2.undistortPoints(pixels, camera.K, distortion, criteria=criteria)
    return np.ascontiguousarray(rays.reshape(camera.height, camera.width, 2), dtype=np.float64)


CAMERA = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)


def warm_up_renderer() -> float:
    """Render a tiny frame with all sensor faults and one with none; return the seconds it took."""
    begin_s = time.monotonic()
    for config in (SyntheticConfig(), SyntheticConfig.ideal()):
        tiny = replace(config, camera=CAMERA, duration_s=0.1, texel_m=0.05)
        make_renderer(tiny, threads=1).render(0)
    return time.monotonic() - begin_s
