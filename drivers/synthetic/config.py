"""What the virtual Kinect sees and how badly: every fault is one number, zero or False is off."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Self

from drivers.camera import PinholeCamera
from drivers.errors import InputError
from drivers.strict_toml import required, setting
from drivers.synthetic.faults import Fault

KINECT_COLOUR = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


class Motion(StrEnum):
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
class ColourEye:
    """The colour sensor. The defaults are those of a Kinect v1 indoors."""

    distortion: tuple[float, ...] = setting(
        (0.05, -0.10, 0.0005, -0.0005, 0.0), "five values of the lens: k1 k2 p1 p2 k3"
    )
    noise_sigma: float = setting(3.0, "noise at mid grey, grey levels", low=0.0)
    softness_px: float = setting(0.9, "blur of the lens and the colour filters, pixels", low=0.0)
    exposure_s: float = setting(0.012, "motion blur, seconds; 0 = a perfect instant", low=0.0)
    gain_drift: float = setting(0.12, "how far brightness drifts, relative; below 1", low=0.0)
    vignetting: float = setting(0.12, "loss of brightness in the corners, relative", low=0.0)
    smooth_edges: bool = setting(True, "average four rays where surfaces meet")


@dataclass(frozen=True)
class DepthEye:
    """The infrared projector and camera (Khoshelham and Elberink, Sensors 2012, section 3)."""

    focal_px: float = setting(580.0, "focal length for an image 640 pixels wide", above=0.0)
    baseline_m: float = setting(0.075, "from the projector to the infrared camera", above=0.0)
    eye_offset_m: float = setting(0.025, "the infrared camera is so far left of the colour camera")
    registration: bool = setting(
        True, "false = depth is seen through the colour camera, without parallax"
    )
    shadows: bool = setting(True, "no reading where the projector's light is hidden")
    disparity_step_px: float = setting(1.0 / 8.0, "steps of the disparity; 0 = exact", low=0.0)
    disparity_sigma_px: float = setting(0.07, "noise of the disparity", low=0.0)
    lateral_sigma_px: float = setting(
        0.7, "edges fray: the depth is that of a neighbour so far away", low=0.0
    )
    min_range_m: float = setting(0.5, "nothing nearer is read", low=0.0)
    max_range_m: float = setting(5.0, "nothing farther is read", above=0.0)


@dataclass(frozen=True)
class Timing:
    """When rows are taken. Rows are read top to bottom; a stamp is that of the middle row."""

    readout_s: float = setting(
        0.020, "rolling shutter: first row to last, of both images; at most a frame", low=0.0
    )
    skew_s: float = setting(0.010, "depth after colour, seconds; at most half a frame")


class MoverKind(StrEnum):
    """What it is that moves."""

    PARCEL = "parcel"  # a printed box that hangs in the air
    PERSON = "person"  # stands on the floor, whatever the height that is given


@dataclass(frozen=True)
class Mover:
    """Something that goes by itself through the view, evenly as the camera sees it.

    It is there from `begin_s` to `end_s`.
    """

    kind: MoverKind = required("what moves")
    begin_s: float = required("when it comes, seconds from the first frame", low=0.0)
    end_s: float = required("when it has gone", above=0.0)
    size_m: tuple[float, float, float] = setting(
        (0.5, 1.75, 0.3), "width, height and depth, metres", low=0.01, high=3.0
    )
    distance_m: float = setting(1.0, "how far along the view, metres", low=0.2)
    begin_view: tuple[float, float] = setting(
        (-1.8, 0.0), "where the camera then sees it: right and down, in half images from the middle"
    )
    end_view: tuple[float, float] = setting((1.8, 0.0), "where the camera sees it in the end")

    def __post_init__(self) -> None:
        if self.begin_s >= self.end_s:
            raise InputError(f"mover {self.kind}: end_s must be after begin_s")


@dataclass(frozen=True)
class SyntheticConfig:
    """A virtual Kinect in a room of its own. Raises InputError if a value makes no sense."""

    seed: int = setting(1, "another seed is another room and another motion", low=0)
    duration_s: float = setting(20.0, "length of the film, seconds; one frame at least", above=0.0)
    rate_hz: float = setting(30.0, "frames a second", above=0.0)
    camera: PinholeCamera = setting(KINECT_COLOUR, "intrinsics of the colour camera")
    depth_factor: float = setting(1000.0, "depth value of one metre", low=1.0, high=10000.0)
    motion: Motion = setting(Motion.HAND_HELD, "how the camera moves when no track is given")
    track: Path | None = setting(
        None, "a trajectory in TUM format (optical camera in a z-up world) to follow"
    )
    track_start_s: float = setting(0.0, "where in the track to begin, from its first stamp")
    loop: bool = setting(False, "play for ever; the motion then ends where it began")
    bare_wall: bool = setting(False, "one wall without texture")
    twin_corners: bool = setting(False, "two opposite corners look the same")
    texel_m: float = setting(0.0025, "size of a texture's pixel, metres", low=0.001)
    colour: ColourEye = field(default_factory=ColourEye)
    depth: DepthEye = field(default_factory=DepthEye)
    timing: Timing = field(default_factory=Timing)
    movers: tuple[Mover, ...] = setting((), "what moves by itself")
    faults: tuple[Fault, ...] = setting((), "what goes wrong with which frames")

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
            (len(self.colour.distortion) == 5, "distortion needs five values: k1 k2 p1 p2 k3"),
            (0 <= self.timing.readout_s <= 2 * half_frame_s, "readout_s must fit in one frame"),
            (abs(self.timing.skew_s) <= half_frame_s, "skew_s must be at most half a frame"),
            (0 <= self.colour.exposure_s <= 2 * half_frame_s, "exposure_s must fit in one frame"),
            (0 <= self.colour.gain_drift < 1, "gain_drift must lie in 0 .. 1"),
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
            colour=ColourEye(
                distortion=NO_DISTORTION,
                noise_sigma=0.0,
                softness_px=0.0,
                exposure_s=0.0,
                gain_drift=0.0,
                vignetting=0.0,
            ),
            depth=DepthEye(
                registration=False,
                shadows=False,
                disparity_step_px=0.0,
                disparity_sigma_px=0.0,
                lateral_sigma_px=0.0,
                min_range_m=0.0,
                max_range_m=13.0,
            ),
            timing=Timing(readout_s=0.0, skew_s=0.0),
        )

    @classmethod
    def light(cls) -> Self:
        """Stand-in for a live camera: quickly rendered, then played round and round."""
        full = cls(duration_s=10.0, loop=True, texel_m=0.004)
        eye = replace(full.colour, distortion=NO_DISTORTION, exposure_s=0.0, smooth_edges=False)
        return replace(full, colour=eye)
