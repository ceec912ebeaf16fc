"""Configuration of the virtual Kinect: each sensor fault is one number; 0 or False disables it."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from drivers.camera import PinholeCamera
from drivers.core.config import Field, FieldError
from drivers.faulty_camera import Fault, FaultKind

KINECT_COLOR = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


class MotionKind(StrEnum):
    """How the camera moves when no track is given."""

    HAND_HELD = "hand-held"  # a slow sweep with the tremor of a hand
    SMOOTH = "smooth"  # the sweep alone
    STILL = "still"
    FLOOR = "floor"  # a hand over the bare floor: most views show one plane
    ORBIT = "orbit"  # a walk around the tables in the middle, with fast turns
    TOUR = "tour"  # a walk through a large room, several times past the same places
    WALL = "wall"  # looks aside, then straight at the wall of `bare_wall`, and back
    WALL_DRIVE = "wall-drive"  # the same from a robot that drives along the wall
    FAST_TURN = "fast-turn"  # a hand that turns away and back, each in half a second
    CREEP = "creep"  # straight on at a millimeter a second
    DRIVEN = "driven"  # a base that is sent velocities


@dataclass(frozen=True)
class ColorSensorModel:
    """The color sensor. The defaults are those of a Kinect v1 indoors."""

    distortion: Annotated[tuple[float, ...], "lens distortion, five values: k1 k2 p1 p2 k3"] = (
        0.05,
        -0.10,
        0.0005,
        -0.0005,
        0.0,
    )
    noise_sigma: Annotated[float, Field("noise at mid gray, gray levels", minimum=0.0)] = 3.0
    softness_px: Annotated[
        float, Field("blur of the lens and the color filters, pixels", minimum=0.0)
    ] = 0.9
    exposure_s: Annotated[
        float, Field("motion blur, seconds; 0 = a perfect instant", minimum=0.0)
    ] = 0.012
    gain_drift: Annotated[
        float, Field("relative drift of the brightness; below 1", minimum=0.0)
    ] = 0.12
    vignetting: Annotated[
        float, Field("loss of brightness in the corners, relative", minimum=0.0)
    ] = 0.12
    smooth_edges: Annotated[bool, "average four rays where surfaces meet"] = True


@dataclass(frozen=True)
class DepthSensorModel:
    """The infrared projector and camera (Khoshelham and Elberink, Sensors 2012, section 3)."""

    focal_px: Annotated[
        float, Field("focal length for an image 640 pixels wide", exclusive_minimum=0.0)
    ] = 580.0
    baseline_m: Annotated[
        float,
        Field("baseline from the projector to the infrared camera, meters", exclusive_minimum=0.0),
    ] = 0.075
    eye_offset_m: Annotated[
        float, "distance of the infrared camera to the left of the color camera, meters"
    ] = 0.025
    registration: Annotated[
        bool, "false = depth is measured from the color camera, without parallax"
    ] = True
    shadows: Annotated[bool, "no reading where the projector's light is occluded"] = True
    disparity_step_px: Annotated[
        float, Field("quantization step of the disparity, pixels; 0 = exact", minimum=0.0)
    ] = 1.0 / 8.0
    disparity_sigma_px: Annotated[float, Field("noise of the disparity, pixels", minimum=0.0)] = (
        0.07
    )
    lateral_sigma_px: Annotated[
        float, Field("ragged edges: mean distance of the pixel whose depth is read", minimum=0.0)
    ] = 0.7
    min_range_m: Annotated[float, Field("smallest depth with a reading, meters", minimum=0.0)] = 0.5
    max_range_m: Annotated[
        float, Field("largest depth with a reading, meters", exclusive_minimum=0.0)
    ] = 5.0


@dataclass(frozen=True)
class ShutterTiming:
    """Timing of the rows. Rows are read top to bottom; a stamp is that of the middle row."""

    readout_s: Annotated[
        float,
        Field("rolling shutter: first row to last, of both images; at most a frame", minimum=0.0),
    ] = 0.020
    skew_s: Annotated[float, "depth after color, seconds; at most half a frame"] = 0.010


@dataclass(frozen=True)
class AccelerometerModel:
    """The accelerometer, which measures motion as well. The defaults are those of a Kinect v1."""

    noise_m_s2: Annotated[float, Field("noise of a reading, m/s^2", minimum=0.0)] = 0.2
    bias_m_s2: Annotated[tuple[float, float, float], "constant error, m/s^2, in camera axes"] = (
        0.12,
        -0.08,
        0.12,
    )


class DynamicObjectKind(StrEnum):
    """Kinds of moving objects."""

    PARCEL = "parcel"  # a printed box that hangs in the air
    PERSON = "person"  # stands on the floor; the view's height is ignored


@dataclass(frozen=True)
class DynamicObjectConfig:
    """An object that crosses the view at an even speed in the image.

    It is in the room from `begin_s` to `end_s`.
    """

    kind: Annotated[DynamicObjectKind, "kind of the moving object"]
    begin_s: Annotated[float, Field("when it appears, seconds from the first frame", minimum=0.0)]
    end_s: Annotated[float, Field("when it disappears, seconds", exclusive_minimum=0.0)]
    size_m: Annotated[
        tuple[float, float, float],
        Field("width, height and depth, meters", minimum=0.01, maximum=3.0),
    ] = (0.5, 1.75, 0.3)
    distance_m: Annotated[float, Field("distance along the optical axis, meters", minimum=0.2)] = (
        1.0
    )
    begin_view: Annotated[
        tuple[float, float],
        "first place in the image: right and down, in half images from the middle",
    ] = (-1.8, 0.0)
    end_view: Annotated[tuple[float, float], "last place in the image"] = (1.8, 0.0)

    def __post_init__(self) -> None:
        if self.begin_s >= self.end_s:
            raise FieldError(("end_s",), "end_s must be after begin_s")


@dataclass(frozen=True)
class SyntheticConfig:
    """A virtual Kinect in a furnished room. Raises InputError."""

    seed: Annotated[int, Field("seed of the room and of the motion", minimum=0)] = 1
    duration_s: Annotated[
        float, Field("length of the sequence, seconds; at least one frame", exclusive_minimum=0.0)
    ] = 20.0
    rate_hz: Annotated[float, Field("frames a second", exclusive_minimum=0.0)] = 30.0
    camera: Annotated[PinholeCamera, "intrinsics of the color camera"] = KINECT_COLOR
    depth_factor: Annotated[
        float, Field("depth value of one meter", minimum=1.0, maximum=10000.0)
    ] = 1000.0
    motion: Annotated[MotionKind, "how the camera moves when no track is given"] = (
        MotionKind.HAND_HELD
    )
    camera_height_m: Annotated[
        float, Field("driven: height of the camera, meters", minimum=0.1, maximum=2.0)
    ] = 0.5
    pitch_down_deg: Annotated[
        float, Field("driven: angle of the view below the horizon", minimum=-45.0, maximum=45.0)
    ] = 10.0
    track: Annotated[
        Path | None, "a trajectory in TUM format (optical camera in a z-up world) to follow"
    ] = None
    track_start_s: Annotated[
        float, "start of playback in the track, seconds from its first stamp"
    ] = 0.0
    loop: Annotated[bool, "play forever; the motion then ends where it began"] = False
    bare_wall: Annotated[bool, "one wall without texture"] = False
    twin_corners: Annotated[bool, "two opposite corners look the same"] = False
    texel_m: Annotated[float, Field("size of a texture's pixel, meters", minimum=0.001)] = 0.0025
    color: ColorSensorModel = field(default_factory=ColorSensorModel)
    depth: DepthSensorModel = field(default_factory=DepthSensorModel)
    timing: ShutterTiming = field(default_factory=ShutterTiming)
    accelerometer: AccelerometerModel = field(default_factory=AccelerometerModel)
    movers: Annotated[tuple[DynamicObjectConfig, ...], "moving objects"] = ()
    faults: Annotated[tuple[Fault, ...], "faults to inject, each into a range of frames"] = ()

    def __post_init__(self) -> None:
        half_frame_s = 0.5 / self.rate_hz if self.rate_hz > 0 else 0.0
        is_driven = self.motion is MotionKind.DRIVEN
        unplugs = any(fault.kind is FaultKind.UNPLUGGED for fault in self.faults)
        checks = (
            (self.seed >= 0, "seed", "must be at least 0"),
            (self.rate_hz > 0, "rate_hz", "must be above 0"),
            (self.duration_s * self.rate_hz >= 1, "duration_s", "must hold at least one frame"),
            (self.camera.width >= 32, "camera.width", "must be at least 32"),
            (self.camera.height >= 32, "camera.height", "must be at least 32"),
            (1 <= self.depth_factor <= 10000, "depth_factor", "must lie in 1 .. 10000"),
            (not (self.bare_wall and self.twin_corners), "twin_corners", "needs all four walls"),
            (not (is_driven and self.track), "track", "cannot be followed by a driven base"),
            (not (is_driven and unplugs), "faults", "cannot unplug the camera of a driven base"),
            (self.texel_m >= 0.001, "texel_m", "must be at least 0.001"),
            (len(self.color.distortion) == 5, "color.distortion", "needs five: k1 k2 p1 p2 k3"),
            (0 <= self.timing.readout_s <= 2 * half_frame_s, "timing.readout_s", "exceeds a frame"),
            (abs(self.timing.skew_s) <= half_frame_s, "timing.skew_s", "exceeds half a frame"),
            (0 <= self.color.exposure_s <= 2 * half_frame_s, "color.exposure_s", "exceeds a frame"),
            (0 <= self.color.gain_drift < 1, "color.gain_drift", "must lie in 0 .. 1"),
        )
        for is_valid, key, message in checks:
            if not is_valid:
                raise FieldError(tuple(key.split(".")), f"{key} {message}")

    @property
    def frame_count(self) -> int:
        """Number of frames of one pass."""
        return round(self.duration_s * self.rate_hz)

    @classmethod
    def ideal(cls) -> Self:
        """A sensor without faults: exact depth, global shutter, no noise."""
        return cls(
            depth_factor=5000.0,
            color=ColorSensorModel(
                distortion=NO_DISTORTION,
                noise_sigma=0.0,
                softness_px=0.0,
                exposure_s=0.0,
                gain_drift=0.0,
                vignetting=0.0,
            ),
            depth=DepthSensorModel(
                registration=False,
                shadows=False,
                disparity_step_px=0.0,
                disparity_sigma_px=0.0,
                lateral_sigma_px=0.0,
                min_range_m=0.0,
                max_range_m=13.0,
            ),
            timing=ShutterTiming(readout_s=0.0, skew_s=0.0),
            accelerometer=AccelerometerModel(noise_m_s2=0.0, bias_m_s2=(0.0, 0.0, 0.0)),
        )

    @classmethod
    def fast(cls) -> Self:
        """A quickly rendered loop that replaces a live camera."""
        full = cls(duration_s=10.0, loop=True, texel_m=0.004)
        color = replace(full.color, distortion=NO_DISTORTION, exposure_s=0.0, smooth_edges=False)
        return replace(full, color=color)
