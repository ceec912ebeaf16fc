"""One frame of the virtual Kinect, from the exact motion to the images that leave the driver."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.geometry import Array, rigid_transform
from drivers.synthetic import colour_sensor, depth_sensor
from drivers.synthetic.atlas import Atlas, paint_atlas
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import Images
from drivers.synthetic.lighting import bulbs
from drivers.synthetic.motion import make_path
from drivers.synthetic.path import Path
from drivers.synthetic.raycast import RayGrid, View, cast, look
from drivers.synthetic.scene import ROOM_HEIGHT_M, furnish
from drivers.synthetic.shade import shade, smooth_edges
from drivers.synthetic.solids import SolidArrays
from drivers.undistort import undistorter

PATH_CHECKS_PER_S = 10


@dataclass(frozen=True)
class Room:
    """What there is to see: solids and their painted skins."""

    solids: SolidArrays
    atlas: Atlas

    @classmethod
    def build(cls, config: SyntheticConfig, path: Path, threads: int) -> "Room":
        """The room of `config`, free of furniture where `path` wants it."""
        checks = max(2, int(config.duration_s * PATH_CHECKS_PER_S))
        free_m = path.free_m(np.linspace(0.0, config.duration_s, checks))
        solids = furnish(config.seed, free_m, config.bare_wall)
        arrays = SolidArrays.pack(solids)
        lights = bulbs(np.random.default_rng([config.seed, 4]), solids[0].half_m)
        return cls(
            arrays, paint_atlas(solids, arrays, lights, config.texel_m, config.seed, threads)
        )


def make_renderer(config: SyntheticConfig, threads: int) -> "Renderer":
    """Build the path and the room of `config`. Raises InputError if its track cannot be used."""
    path = make_path(config, ROOM_HEIGHT_M)
    return Renderer(config, path, Room.build(config, path, threads))


class Renderer:
    """A sensor moving through a room. `render` may run on many threads."""

    def __init__(self, config: SyntheticConfig, path: Path, room: Room) -> None:
        self._config = config
        self._path = path
        self._room = room
        camera, eye = config.camera, config.depth
        self._distortion = np.array(config.colour.distortion)
        self._undistort = undistorter(camera, config.colour.distortion)
        self._colour_grid = RayGrid.of(pixel_rays(camera, self._distortion))
        self._infrared = depth_sensor.infrared_camera(eye, camera)
        self._infrared_grid = RayGrid.of(pixel_rays(self._infrared, np.zeros(5)))
        self._vignette = colour_sensor.vignette(camera, config.colour.vignetting)

    def render(self, index: int) -> Images:
        """Frame `index`: the same bytes whenever and wherever it is rendered."""
        stamp_s = index / self._config.rate_hz
        rng = np.random.default_rng([self._config.seed, 5, index])
        colour = self._colour(stamp_s, rng)
        depth = self._depth(stamp_s + self._config.timing.skew_s, rng)
        return Images(self._undistort.colour(colour), self._undistort.depth(depth))

    def _row_times(self, middle_s: float) -> Array:
        height = self._config.camera.height
        return middle_s + self._config.timing.readout_s * (np.arange(height) / (height - 1) - 0.5)

    def _colour(self, stamp_s: float, rng: np.random.Generator) -> NDArray[np.uint8]:
        config, rays, times_s = self._config, self._colour_grid.rays, self._row_times(stamp_s)
        T_world_row = self._path.poses(times_s)
        view = look(self._room.solids, self._colour_grid, T_world_row)
        depth_m, solid = cast(rays, view.kind, view.frames, view.candidates, view.near_m)
        image = self._shade(view, depth_m, solid)
        if config.colour.exposure_s > 0:
            half_s = config.colour.exposure_s / 2
            T_opening_now = np.linalg.inv(self._path.poses(times_s - half_s)) @ T_world_row
            T_closing_now = np.linalg.inv(self._path.poses(times_s + half_s)) @ T_world_row
            image = colour_sensor.motion_blur(
                image, rays, depth_m, T_opening_now, T_closing_now, config.camera.fx
            )
        gain = colour_sensor.gain_at(config.colour, stamp_s, config.duration_s)
        return colour_sensor.expose(image, gain, self._vignette, config.colour, rng)

    def _shade(
        self, view: View, depth_m: NDArray[np.float32], solid: NDArray[np.int32]
    ) -> NDArray[np.float32]:
        atlas, rays, pixel = self._room.atlas, self._colour_grid.rays, 1.0 / self._config.camera.fx
        image, surface = shade(
            rays, depth_m, solid, view.kind, view.frames, atlas.texels, atlas.levels, pixel
        )
        if self._config.colour.smooth_edges:
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

    def _depth(self, middle_s: float, rng: np.random.Generator) -> NDArray[np.uint16]:
        config, eye, camera = self._config, self._config.depth, self._config.camera
        T_world_row = self._path.poses(self._row_times(middle_s))
        if not eye.registration:
            true_m = self._distances(self._colour_grid, T_world_row)
            measured_m = depth_sensor.measure(true_m, eye, rng)
            readings = np.minimum(measured_m * np.float32(config.depth_factor), 65535)
            depth: NDArray[np.uint16] = np.rint(readings).astype(np.uint16)
            return depth
        T_colour_infrared = rigid_transform(np.eye(3), (-eye.eye_offset_m, 0.0, 0.0))
        true_m = self._distances(self._infrared_grid, T_world_row @ T_colour_infrared)
        return depth_sensor.register(
            depth_sensor.measure(true_m, eye, rng),
            (self._infrared.fx, self._infrared.cx, self._infrared.cy),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            self._distortion,
            eye.eye_offset_m,
            config.depth_factor,
        )

    def _distances(self, grid: RayGrid, T_world_row: Array) -> NDArray[np.float32]:
        view = look(self._room.solids, grid, T_world_row)
        return cast(grid.rays, view.kind, view.frames, view.candidates, view.near_m)[0]


def pixel_rays(camera: PinholeCamera, distortion: Array) -> Array:
    """(H, W, 2): where on the plane z = 1 each pixel of the raw image looks."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rays = cv2.undistortPoints(pixels, camera.K, distortion, criteria=criteria)
    return np.ascontiguousarray(rays.reshape(camera.height, camera.width, 2), dtype=np.float64)
