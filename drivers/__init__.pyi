"""The public names of the cameras."""

from drivers.camera import EndOfStream as EndOfStream
from drivers.camera import FrameTimeout as FrameTimeout
from drivers.camera import Led as Led
from drivers.camera import PinholeCamera as PinholeCamera
from drivers.camera import PlaybackMode as PlaybackMode
from drivers.camera import RgbdCamera as RgbdCamera
from drivers.camera import RgbdFrame as RgbdFrame
from drivers.camera import SensorConfig as SensorConfig
from drivers.core.errors import CameraError as CameraError
from drivers.core.errors import CameraLostError as CameraLostError
from drivers.core.errors import CameraNotFoundError as CameraNotFoundError
from drivers.core.errors import InputError as InputError
from drivers.registry import CAMERAS as CAMERAS
from drivers.registry import CameraRequest as CameraRequest
from drivers.registry import open_camera as open_camera
from drivers.synthetic.config import SyntheticConfig as SyntheticConfig
