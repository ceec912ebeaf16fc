"""One pass over a bag: stamps of its images, and all other messages that a replay uses."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from drivers.bag.bag_file import BagFile, Message
from drivers.bag.image_messages import (
    ImageMessage,
    MessageCursor,
    MessageKey,
    number_messages,
    stamp_ns_of,
)
from drivers.bag.topics import BagTopics
from drivers.bag.transforms import TransformTree
from drivers.core.errors import InputError
from drivers.recording.frames import FrameStamps

NS_PER_S = 1_000_000_000


@dataclass
class ImageTrack:
    """The images of one topic, in order of recording.

    Attributes:
        first: The first message, decoded; None without images.
        keys: Header stamp, ns, and key of each message.
    """

    first: Any = None
    keys: list[tuple[int, MessageKey]] = field(default_factory=list)


@dataclass
class BagContents:
    """What the pass has found.

    Attributes:
        color: The color images.
        depth: The depth images.
        infos: First CameraInfo by topic.
        transforms: All transforms.
        accelerations: By topic: stamp in ns, frame and Imu message.
        gravity: Stamp in ns and message of each frame's gravity.
        poses: Stamp in ns and message of each true pose.
        frame_stamps: Stamps of each frame, in recordings of this program.
        camera_file: Text of the camera file, in recordings of this program.
    """

    color: ImageTrack = field(default_factory=ImageTrack)
    depth: ImageTrack = field(default_factory=ImageTrack)
    infos: dict[str, Any] = field(default_factory=dict)
    transforms: TransformTree = field(default_factory=TransformTree)
    accelerations: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    gravity: list[tuple[int, Any]] = field(default_factory=list)
    poses: list[tuple[int, Any]] = field(default_factory=list)
    frame_stamps: list[FrameStamps] = field(default_factory=list)
    camera_file: str = ""


def read_contents(bag: BagFile, topics: BagTopics) -> BagContents:
    """Read a file once.

    Raises:
        InputError: It is damaged, or a message does not have the layout of its type.
    """
    contents = BagContents()
    wanted = topics.all | {topics.color, topics.depth}
    for key, message in number_messages(bag.messages(wanted)):
        _add(contents, topics, bag, key, message)
    return contents


def _add(
    contents: BagContents, topics: BagTopics, bag: BagFile, key: MessageKey, message: Message
) -> None:
    topic, decoded = message.topic, bag.decode(message)
    if topic in (topics.color, topics.depth):
        track = contents.color if topic == topics.color else contents.depth
        track.first = track.first or decoded
        track.keys.append((stamp_ns_of(decoded, message.log_ns), key))
    elif topic in topics.transforms:
        contents.transforms.add(decoded)
    elif topic in topics.imus:
        reading = (stamp_ns_of(decoded, message.log_ns), decoded)
        contents.accelerations.setdefault(topic, []).append(reading)
    elif topic == topics.gravity:
        contents.gravity.append((stamp_ns_of(decoded, message.log_ns), decoded.vector))
    elif topic == topics.pose:
        contents.poses.append((stamp_ns_of(decoded, message.log_ns), decoded))
    elif topic == topics.frame_stamps:
        contents.frame_stamps.append(parse_frame_stamps(decoded.data, f"{bag.path}: {topic}"))
    elif topic == topics.camera_file:
        contents.camera_file = contents.camera_file or decoded.data
    else:
        contents.infos.setdefault(topic, decoded)


def format_frame_stamps(stamps: FrameStamps) -> str:
    """Format the message of a frame's exact stamps, as JSON."""
    return json.dumps({"color_stamp_s": f"{stamps.color:f}", "depth_stamp_s": f"{stamps.depth:f}"})


def parse_frame_stamps(text: str, location: str) -> FrameStamps:
    """Invert `format_frame_stamps`. Raises InputError."""
    try:
        stamps = json.loads(text)
        return FrameStamps(Decimal(stamps["color_stamp_s"]), Decimal(stamps["depth_stamp_s"]))
    except (ValueError, KeyError, TypeError, ArithmeticError) as error:
        raise InputError(f"{location}: is not a frame's stamps: {text[:80]!r}") from error


def to_ns(stamp: Decimal) -> int:
    """Round a stamp in seconds to ns, as in a message's header."""
    return int(stamp.scaleb(9).to_integral_value())


def exact_stamps(stamps: Sequence[Decimal]) -> dict[int, Decimal]:
    """Map stamps in ns to the exact ones."""
    return {to_ns(stamp): stamp for stamp in stamps}


@dataclass(frozen=True)
class ImageFactory:
    """Makes the images of a bag."""

    cursor: MessageCursor
    file: Path
    depth_factor: float

    def make(self, track: ImageTrack, exact: dict[int, Decimal]) -> list[ImageMessage]:
        """Make the images of a topic, with exact stamps where they are known."""
        return [
            ImageMessage(
                exact.get(stamp_ns) or Decimal(stamp_ns).scaleb(-9),
                self.file,
                f"{key.topic}, message {number}",
                self.cursor,
                key,
                self.depth_factor,
            )
            for number, (stamp_ns, key) in enumerate(track.keys, 1)
        ]
