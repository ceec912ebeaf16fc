"""Images of a bag: reading of single messages, and conversion of raw, JPEG, PNG and RVL ones."""

import struct
from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.bag.bag_file import BagFile, Message, open_bag_file
from drivers.bag.bag_storage import BagStorage
from drivers.bag.rvl import decode_rvl
from drivers.camera import MAX_DEPTH_VALUE
from drivers.core import InputError
from drivers.recording.image_decoding import (
    BgrImage,
    DepthImage,
    UnreadableFrameError,
    decode_color,
    decode_depth,
    decode_image,
    reduce_to_8_bits,
    stored_color,
    stored_depth,
)
from drivers.recording.recorded_frames import RecordedImage
from drivers.ros_messages.sensors import (
    COMPRESSED_DEPTH_HEADER,
    COMPRESSED_IMAGE_SCHEMA,
    IMAGE_SCHEMA,
)

MAX_RECENT_MESSAGES = 16
# A message farther ahead than this is looked up by the file's index.
MAX_SKIP_NS = 2_000_000_000


@dataclass(frozen=True)
class MessageKey:
    """Identity of a message: its topic, its log time, and its number among equal ones."""

    topic: str
    log_ns: int
    repeat: int


def number_messages(messages: Iterable[Message]) -> Iterator[tuple[MessageKey, Message]]:
    """Yield messages with their keys. The first log time must be complete."""
    last: dict[str, MessageKey] = {}
    for message in messages:
        before = last.get(message.topic)
        is_repeat = before is not None and before.log_ns == message.log_ns
        key = MessageKey(
            message.topic, message.log_ns, before.repeat + 1 if before and is_repeat else 0
        )
        last[message.topic] = key
        yield key, message


class MessageCursor:
    """Reads messages by key. Opens the bag at the first read."""

    def __init__(self, storage: BagStorage, topics: Collection[str]) -> None:
        self._storage, self._topics = storage, topics
        self._bag: BagFile | None = None
        self._stream: Iterator[tuple[MessageKey, Message]] = iter(())
        self._position_ns = 0
        self._recent: OrderedDict[MessageKey, Message] = OrderedDict()

    @property
    def path(self) -> Path:
        """The bag's file or folder."""
        return self._storage.path

    def read(self, key: MessageKey) -> Any:
        """Read and decode a message. Raises UnreadableFrameError."""
        try:
            self._bag = self._bag or open_bag_file(self._storage)
            if key not in self._recent:
                self._advance(self._bag, key)
            return self._bag.decode(self._recent[key])
        except InputError as error:
            raise UnreadableFrameError(str(error)) from error

    def _advance(self, bag: BagFile, key: MessageKey) -> None:
        if not self._position_ns <= key.log_ns <= self._position_ns + MAX_SKIP_NS:
            self._seek(bag, key.log_ns)
        if not self._read_until(key):
            self._seek(bag, key.log_ns)
            if not self._read_until(key):
                raise InputError(f"{self.path}: a message of {key.topic} is gone; reopen the file")

    def _seek(self, bag: BagFile, log_ns: int) -> None:
        self._recent.clear()
        self._stream = number_messages(bag.messages(self._topics, log_ns))
        self._position_ns = log_ns

    def _read_until(self, key: MessageKey) -> bool:
        for each, message in self._stream:
            self._position_ns = each.log_ns
            self._recent[each] = message
            if len(self._recent) > MAX_RECENT_MESSAGES:
                self._recent.popitem(last=False)
            if each == key:
                return True
        return False

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        if self._bag is not None:
            self._bag.close()
        self._bag, self._stream, self._position_ns = None, iter(()), 0
        self._recent.clear()


IMAGE_TYPES = (IMAGE_SCHEMA, COMPRESSED_IMAGE_SCHEMA)
DEPTH_ENCODINGS = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
Encoding = tuple[type[np.generic], int, int | None]
_COLOR_8_BITS: dict[str, Encoding] = {
    "bgr8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, None),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2BGR),
    "mono8": (np.uint8, 1, cv2.COLOR_GRAY2BGR),
    "8UC1": (np.uint8, 1, cv2.COLOR_GRAY2BGR),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "8UC4": (np.uint8, 4, cv2.COLOR_BGRA2BGR),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (np.uint8, 1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (np.uint8, 1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (np.uint8, 1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (np.uint8, 1, cv2.COLOR_BayerGRBG2BGR),
}
# Type of a value, number of channels, and OpenCV's conversion to BGR. 16UC1 is depth.
COLOR_ENCODINGS: dict[str, Encoding] = {
    **_COLOR_8_BITS,
    **{
        name.replace("8", "16"): (np.uint16, channels, conversion)
        for name, (_, channels, conversion) in _COLOR_8_BITS.items()
        if name != "8UC1"
    },
    # ROS 1 and older ROS 2 have the names with 422.
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2BGR_YUYV),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2BGR_YUYV),
}
# Columns and rows.
RVL_SIZE = struct.Struct("<II")
# A larger median is in millimeters.
MAX_MEDIAN_DEPTH_M = 50.0


@dataclass(frozen=True)
class ImageMessage(RecordedImage):
    """An image of a bag.

    Attributes:
        depth_factor: Value per meter of depth that the message has in meters.
    """

    cursor: MessageCursor
    key: MessageKey
    depth_factor: float

    @property
    def log_stamp(self) -> Decimal:
        """The log time of the message, s."""
        return Decimal(self.key.log_ns).scaleb(-9)

    @property
    def name(self) -> str:
        """Bag, topic and stamp."""
        return f"{self.cursor.path}: {self.key.topic} at {self.stamp}"

    def read_message(self) -> Any:
        """Read the message. Raises UnreadableFrameError."""
        return self.cursor.read(self.key)

    def read_color(self) -> BgrImage:
        """Read a raw or compressed color image."""
        return color_from_message(self.read_message(), self.name)

    def read_depth(self) -> DepthImage:
        """Read raw or compressed depth; depth in meters is rounded."""
        return depth_from_message(self.read_message(), self.name, self.depth_factor)

    def read_stored_color(self) -> bytes | BgrImage:
        """Read a PNG or JPEG as it is stored, and decode other images."""
        message = self.read_message()
        if hasattr(message, "encoding"):
            return color_from_message(message, self.name)
        return stored_color(bytes(message.data), self.name)

    def read_stored_depth(self) -> bytes | DepthImage:
        """Read the PNG of compressed depth as it is stored, and decode other images."""
        message = self.read_message()
        if hasattr(message, "encoding") or is_depth_in_meters(message) or "rvl" in message.format:
            return depth_from_message(message, self.name, self.depth_factor)
        has_header = "compressedDepth" in message.format
        data = bytes(message.data)[COMPRESSED_DEPTH_HEADER.size if has_header else 0 :]
        return stored_depth(data, self.name)


def is_depth_in_meters(message: Any) -> bool:
    """Whether a message of depth has meters; else it has the sensor's millimeters."""
    return getattr(message, "encoding", None) == "32FC1" or (
        getattr(message, "format", "").startswith("32FC1")
    )


def color_from_message(message: Any, name: str) -> BgrImage:
    """Convert to (height, width, 3) BGR uint8.

    Raises:
        UnreadableFrameError: The encoding is not known, or the data is incomplete.
    """
    if not hasattr(message, "encoding"):
        return decode_color(bytes(message.data), name)
    if message.encoding not in COLOR_ENCODINGS:
        raise UnreadableFrameError(
            f"{name}: encoding {message.encoding} is not color; use one of "
            f"{', '.join(COLOR_ENCODINGS)}"
        )
    value_type, channels, conversion = COLOR_ENCODINGS[message.encoding]
    image = reduce_to_8_bits(_pixels(message, np.dtype(value_type), channels, name))
    if conversion is None:
        return np.ascontiguousarray(image)
    try:
        return cv2.cvtColor(image, conversion)  # type: ignore[return-value]
    except cv2.error as error:  # an odd width of YUV, or no whole cell of a Bayer pattern
        raise UnreadableFrameError(
            f"{name}: {message.width}x{message.height} pixels are no {message.encoding}; remove "
            "the message"
        ) from error


def depth_from_message(message: Any, name: str, depth_factor: float) -> DepthImage:
    """Convert to (height, width) uint16, 0 = no reading.

    Args:
        depth_factor: Value per meter of the result, if the message is in meters.

    Raises:
        UnreadableFrameError: The encoding is not known, or the data is incomplete.
    """
    if not hasattr(message, "encoding"):
        return _decompress_depth(message, name, depth_factor)
    if message.encoding not in DEPTH_ENCODINGS:
        raise UnreadableFrameError(
            f"{name}: encoding {message.encoding} is not depth; use one of "
            f"{', '.join(DEPTH_ENCODINGS)}"
        )
    image = _pixels(message, np.dtype(DEPTH_ENCODINGS[message.encoding]), 1, name)
    if image.dtype == np.float32:
        return _depth_from_meters(image, depth_factor, name)
    return np.ascontiguousarray(image)


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, name: str) -> NDArray[Any]:
    """View the pixels, (height, width) or (height, width, channels), in this machine's order."""
    order = dtype.newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * dtype.itemsize
    step = message.step or row_bytes
    data = np.asarray(message.data, np.uint8)
    if step < row_bytes or len(data) < step * message.height or not message.height * message.width:
        raise UnreadableFrameError(
            f"{name}: is incomplete ({len(data)} bytes for {message.width}x{message.height} "
            f"{message.encoding}); remove the message"
        )
    rows = data[: step * message.height].reshape(message.height, step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(order).astype(dtype, copy=False)
    return pixels.reshape(message.height, message.width, channels) if channels > 1 else pixels


def _depth_from_meters(depth_m: NDArray[np.float32], depth_factor: float, name: str) -> DepthImage:
    """Convert meters; NaN, infinite and too large values have no reading."""
    is_reading = (depth_m > 0) & (depth_m < np.inf)
    is_far = is_reading & (depth_m > MAX_MEDIAN_DEPTH_M)
    if 2 * np.count_nonzero(is_far) > np.count_nonzero(is_reading):
        median = float(np.median(depth_m[is_reading]))
        raise UnreadableFrameError(
            f"{name}: 32FC1 is depth in meters, but the median is {median:.4g}; write millimeters "
            f"as 16UC1, or divide them by 1000, which would give {median / 1000:.2g} m"
        )
    values = np.nan_to_num(np.rint(depth_m * np.float32(depth_factor)), nan=0.0, posinf=0.0)
    values[(values < 0) | (values > MAX_DEPTH_VALUE)] = 0
    depth: DepthImage = values.astype(np.uint16)
    return depth


def _decompress_depth(message: Any, name: str, depth_factor: float) -> DepthImage:
    """Decode compressed depth: a PNG, or RVL, with the header of compressedDepth or without."""
    data = bytes(message.data)
    if "compressedDepth" not in message.format:
        return decode_depth(data, name)
    if len(data) <= COMPRESSED_DEPTH_HEADER.size:
        raise UnreadableFrameError(f"{name}: is empty; remove the message")
    _, a, b = COMPRESSED_DEPTH_HEADER.unpack_from(data)
    image = data[COMPRESSED_DEPTH_HEADER.size :]
    is_rvl = "rvl" in message.format
    if not message.format.startswith("32FC1"):
        return _decode_rvl(image, name) if is_rvl else decode_depth(image, name)
    inverse = (_decode_rvl if is_rvl else decode_image)(image, name).astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = np.where(inverse > 0, a / (inverse - b), 0.0)
    return _depth_from_meters(depth_m, depth_factor, name)


def _decode_rvl(data: bytes, name: str) -> DepthImage:
    """Decode RVL after the image's size, which compressed_depth_image_transport writes first."""
    try:
        width, height = RVL_SIZE.unpack_from(data)
        return decode_rvl(data[RVL_SIZE.size :], height, width)
    except (ValueError, struct.error) as error:
        raise UnreadableFrameError(f"{name}: is no depth image in RVL: {error}") from error
