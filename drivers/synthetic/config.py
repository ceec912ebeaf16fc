"""What the virtual Kinect sees and how badly: every fault is one number, zero or False is off."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Self

from drivers.camera import PinholeCamera
from drivers.errors import InputError
from drivers.synthetic.faults import Fault

KINECT_COLOUR = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


class Motion(StrEnum):
    """How the camera moves when no track is given."""

    HAND_HELD = "hand-held"  # a slow sweep with the tremor of a hand
    SMOOTH = "smooth"  # the sweep alone
    STILL = "still"


@dataclass(frozen=True)
class ColourEye:
    """The colour sensor. Sensible values are those of a Kinect v1 indoors."""

    distortion: tuple[float, ...] = (0.05, -0.10, 0.0005, -0.0005, 0.0)  # k1 k2 p1 p2 k3
    noise_sigma: float = 3.0  # grey levels at mid grey
    softness_px: float = 0.9  # blur of the lens and of the colour filter array
    exposure_s: float = 0.012  # motion blur; 0 = a perfect instant
    gain_drift: float = 0.12  # automatic exposure: relative amplitude
    vignetting: float = 0.12  # loss of brightness in the corners
    smooth_edges: bool = True  # average four rays where surfaces meet


@dataclass(frozen=True)
class DepthEye:
    """The infrared projector and camera (Khoshelham and Elberink, Sensors 2012, section 3)."""

    focal_px: float = 580.0  # of a 640-pixel-wide image
    baseline_m: float = 0.075  # projector to infrared camera
    eye_offset_m: float = 0.025  # infrared camera to the left of the colour camera
    registration: bool = True  # False: depth is seen through the colour eye, without parallax
    shadows: bool = True  # no reading where the projector is hidden
    disparity_step_px: float = 1.0 / 8.0
    disparity_sigma_px: float = 0.07
    lateral_sigma_px: float = 0.7  # edges fray: the depth is that of a neighbour
    min_range_m: float = 0.5
    max_range_m: float = 5.0


@dataclass(frozen=True)
class Timing:
    """When rows are taken. Rows are read top to bottom; a stamp is that of the middle row."""

    readout_s: float = 0.020  # rolling shutter: first row to last, both eyes
    skew_s: float = 0.010  # depth after colour


@dataclass(frozen=True)
class SyntheticConfig:
    """A virtual Kinect in a room of its own. Raises InputError if a value makes no sense."""

    seed: int = 1  # another seed is another room and another motion
    duration_s: float = 20.0
    rate_hz: float = 30.0
    camera: PinholeCamera = KINECT_COLOUR
    depth_factor: float = 1000.0
    motion: Motion = Motion.HAND_HELD
    track: Path | None = None  # a TUM trajectory (optical camera in a z-up world) to follow
    track_start_s: float = 0.0  # where in the track to begin, from its first stamp
    loop: bool = False  # play for ever; the motion then ends where it began
    bare_wall: bool = False  # one wall without texture
    texel_m: float = 0.0025  # size of a texture's pixel
    colour: ColourEye = field(default_factory=ColourEye)
    depth: DepthEye = field(default_factory=DepthEye)
    timing: Timing = field(default_factory=Timing)
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        half_frame_s = 0.5 / self.rate_hz if self.rate_hz > 0 else 0.0
        checks = (
            (self.seed >= 0, "seed must be at least 0"),
            (self.rate_hz > 0, "rate_hz must be above 0"),
            (self.duration_s * self.rate_hz >= 1, "duration_s must hold at least one frame"),
            (min(self.camera.width, self.camera.height) >= 32, "images need at least 32 x 32"),
            (1 <= self.depth_factor <= 10000, "depth_factor must lie in 1 .. 10000"),
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
