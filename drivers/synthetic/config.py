"""What the virtual Kinect sees and how badly: every fault is one number, zero or False is off."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Self

from drivers.camera import PinholeCamera
from drivers.core.config import config_field, required_field
from drivers.core.errors import InputError
from drivers.synthetic.fault_injection import Fault

KINECT_COLOR = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


class MotionKind(StrEnum):
    """How the camera moves when no track is given."""

    HAND_HELD = "hand-held"  # a slow sweep with the tremor of a hand
    SMOOTH = "smooth"  # the sweep alone
    STILL = "still"
    FLOOR = "floor"  # a hand over the bare floor: one plane is all that is mostly seen
    ORBIT = "orbit"  # a walk around what stands in the middle, with fast turns
    TOUR = "tour"  # a walk through a large room, several times past the same places
    WALL = "wall"  # looks aside, then straight at the wall that `bare_wall` means, and back
    FAST_TURN = "fast-turn"  # a hand that turns away and back, each in half a second
    CREEP = "creep"  # straight on by a millimetre a second


@dataclass(frozen=True)
class ColorSensorModel:
    """The color sensor. The defaults are those of a Kinect v1 indoors."""

    distortion: tuple[float, ...] = config_field(
        (0.05, -0.10, 0.0005, -0.0005, 0.0), "five values of the lens: k1 k2 p1 p2 k3"
    )
    noise_sigma: float = config_field(3.0, "noise at mid gray, gray levels", minimum=0.0)
    softness_px: float = config_field(
        0.9, "blur of the lens and the color filters, pixels", minimum=0.0
    )
    exposure_s: float = config_field(
        0.012, "motion blur, seconds; 0 = a perfect instant", minimum=0.0
    )
    gain_drift: float = config_field(
        0.12, "how far brightness drifts, relative; below 1", minimum=0.0
    )
    vignetting: float = config_field(
        0.12, "loss of brightness in the corners, relative", minimum=0.0
    )
    smooth_edges: bool = config_field(True, "average four rays where surfaces meet")


@dataclass(frozen=True)
class DepthSensorModel:
    """The infrared projector and camera (Khoshelham and Elberink, Sensors 2012, section 3)."""

    focal_px: float = config_field(
        580.0, "focal length for an image 640 pixels wide", exclusive_minimum=0.0
    )
    baseline_m: float = config_field(
        0.075, "from the projector to the infrared camera", exclusive_minimum=0.0
    )
    eye_offset_m: float = config_field(
        0.025, "the infrared camera is so far left of the color camera"
    )
    registration: bool = config_field(
        True, "false = depth is seen through the color camera, without parallax"
    )
    shadows: bool = config_field(True, "no reading where the projector's light is hidden")
    disparity_step_px: float = config_field(
        1.0 / 8.0, "steps of the disparity; 0 = exact", minimum=0.0
    )
    disparity_sigma_px: float = config_field(0.07, "noise of the disparity", minimum=0.0)
    lateral_sigma_px: float = config_field(
        0.7, "edges fray: the depth is that of a neighbour so far away", minimum=0.0
    )
    min_range_m: float = config_field(0.5, "nothing nearer is read", minimum=0.0)
    max_range_m: float = config_field(5.0, "nothing farther is read", exclusive_minimum=0.0)


@dataclass(frozen=True)
class ShutterTiming:
    """When rows are taken. Rows are read top to bottom; a stamp is that of the middle row."""

    readout_s: float = config_field(
        0.020, "rolling shutter: first row to last, of both images; at most a frame", minimum=0.0
    )
    skew_s: float = config_field(0.010, "depth after color, seconds; at most half a frame")


class DynamicObjectKind(StrEnum):
    """What it is that moves."""

    PARCEL = "parcel"  # a printed box that hangs in the air
    PERSON = "person"  # stands on the floor, whatever the height that is given


@dataclass(frozen=True)
class DynamicObjectConfig:
    """Something that goes by itself through the view, evenly as the camera sees it.

    It is there from `start_s` to `end_s`.
    """

    kind: DynamicObjectKind = required_field("what moves")
    begin_s: float = required_field("when it comes, seconds from the first frame", minimum=0.0)
    end_s: float = required_field("when it has gone", exclusive_minimum=0.0)
    size_m: tuple[float, float, float] = config_field(
        (0.5, 1.75, 0.3), "width, height and depth, metres", minimum=0.01, maximum=3.0
    )
    distance_m: float = config_field(1.0, "how far along the view, metres", minimum=0.2)
    begin_view: tuple[float, float] = config_field(
        (-1.8, 0.0), "where the camera then sees it: right and down, in half images from the middle"
    )
    end_view: tuple[float, float] = config_field((1.8, 0.0), "where the camera sees it in the end")

    def __post_init__(self) -> None:
        if self.begin_s >= self.end_s:
            raise InputError(f"mover {self.kind}: end_s must be after begin_s")


@dataclass(frozen=True)
class SyntheticConfig:
    """A virtual Kinect in a room of its own. Raises InputError if a value makes no sense."""

    seed: int = config_field(1, "another seed is another room and another motion", minimum=0)
    duration_s: float = config_field(
        20.0, "length of the film, seconds; one frame at least", exclusive_minimum=0.0
    )
    rate_hz: float = config_field(30.0, "frames a second", exclusive_minimum=0.0)
    camera: PinholeCamera = config_field(KINECT_COLOR, "intrinsics of the color camera")
    depth_factor: float = config_field(
        1000.0, "depth value of one metre", minimum=1.0, maximum=10000.0
    )
    motion: MotionKind = config_field(
        MotionKind.HAND_HELD, "how the camera moves when no track is given"
    )
    track: Path | None = config_field(
        None, "a trajectory in TUM format (optical camera in a z-up world) to follow"
    )
    track_start_s: float = config_field(0.0, "where in the track to begin, from its first stamp")
    loop: bool = config_field(False, "play for ever; the motion then ends where it began")
    bare_wall: bool = config_field(False, "one wall without texture")
    twin_corners: bool = config_field(False, "two opposite corners look the same")
    texel_m: float = config_field(0.0025, "size of a texture's pixel, metres", minimum=0.001)
    color: ColorSensorModel = field(default_factory=ColorSensorModel)
    depth: DepthSensorModel = field(default_factory=DepthSensorModel)
    timing: ShutterTiming = field(default_factory=ShutterTiming)
    movers: tuple[DynamicObjectConfig, ...] = config_field((), "what moves by itself")
    faults: tuple[Fault, ...] = config_field((), "what goes wrong with which frames")

    def __post_init__(self) -> None:
        half_frame_s = 0.5 / self.rate_hz if self.rate_hz > 0 else 0.0
        checks = (
            (self.seed >= 0, "seed must be at least 0"),
            (self.rate_hz > 0, "rate_hz must be above 0"),
            (self.duration_s * self.rate_hz >= 1, "duration_s must hold at least one frame"),
            (min(self.camera.width, self.camera.height) >= 32, "images need at least 32 x 32"),
            (1 <= self.depth_factor <= 10000, "depth_factor must lie in 1 .. 10000"),
            (not (self.bare_wall and self.twin_corners), "twin_corners need all four walls"),
            (self.texel_m >= 0.001, "texel_m must be at least 0.001"),
            (len(self.color.distortion) == 5, "distortion needs five values: k1 k2 p1 p2 k3"),
            (0 <= self.timing.readout_s <= 2 * half_frame_s, "readout_s must fit in one frame"),
            (abs(self.timing.skew_s) <= half_frame_s, "skew_s must be at most half a frame"),
            (0 <= self.color.exposure_s <= 2 * half_frame_s, "exposure_s must fit in one frame"),
            (0 <= self.color.gain_drift < 1, "gain_drift must lie in 0 .. 1"),
        )
        for holds, message in checks:
            if not holds:
                raise InputError(f"synthetic camera: {message}")

    @property
    def frame_count(self) -> int:
        """Frames of one pass."""
        return round(self.duration_s * self.rate_hz)

    @classmethod
    def ideal(cls) -> Self:
        """No fault at all: exact depth, one instant, no noise."""
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
        )

    @classmethod
    def fast(cls) -> Self:
        """Stand-in for a live camera: quickly rendered, then played round and round."""
        full = cls(duration_s=10.0, loop=True, texel_m=0.004)
        eye = replace(full.color, distortion=NO_DISTORTION, exposure_s=0.0, smooth_edges=False)
        return replace(full, color=eye)
