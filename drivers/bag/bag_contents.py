"""The topics of a bag that a replay uses, and one pass over them: image stamps, other messages."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from drivers.bag.bag_file import TF_MESSAGE_TYPES, BagFile, Message, stamp_ns_of
from drivers.bag.calibration import TransformTree
from drivers.bag.image_messages import (
    IMAGE_TYPES,
    ImageMessage,
    MessageCursor,
    MessageKey,
    number_messages,
)
from drivers.core import InputError
from drivers.recording.frame_encoding import FrameStamps
from drivers.recording.recording import ImageTopics
from drivers.ros_messages.cdr import STRING_SCHEMA
from drivers.ros_messages.navigation import (
    ODOMETRY_SCHEMA,
    POSE_SCHEMA,
    TRANSFORM_SCHEMA,
    VECTOR_SCHEMA,
)
from drivers.ros_messages.sensors import CAMERA_INFO_SCHEMA, IMU_SCHEMA

POSE_TYPES = (
    POSE_SCHEMA,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    TRANSFORM_SCHEMA,
    ODOMETRY_SCHEMA,
)
# Names of the images in recordings of this program, after the namespace.
OWN_IMAGES = ("/rgb/image_raw", "/depth_registered/image_raw", "/depth_registered/image")
COMPRESSED_PARTS = ("compressed", "compressedDepth")
# The best first.
DEPTH_NAMES = ("image_raw", "image_rect_raw", "image", "image_rect")
COLOR_NAMES = ("image_color", "image_raw", "image", "image_rect_color", "image_rect")
TRUTH_WORDS = ("groundtruth", "ground_truth", "mocap", "vicon", "vrpn", "optitrack")
NO_COLOR_WORDS = ("depth", "infra", "/ir", "disparity", "confidence", "stereo", "mask")


@dataclass(frozen=True)
class BagTopics:
    """The topics that a replay uses; "" for those that are not in the file.

    Attributes:
        transforms: /tf and /tf_static.
        imus: Accelerometers.
        gravity: Gravity with each frame, in recordings of this program.
        pose: True poses.
        frame_stamps: Exact stamps of each frame, in recordings of this program.
        camera_file: The camera file, in recordings of this program.
    """

    color: str
    depth: str
    color_info: str
    depth_info: str
    transforms: tuple[str, ...]
    imus: tuple[str, ...]
    gravity: str
    pose: str
    frame_stamps: str
    camera_file: str

    @property
    def of_frames(self) -> set[str]:
        """The topics of images and cameras."""
        infos = (self.color_info, self.depth_info)
        topics = (self.color, self.depth, *infos, self.frame_stamps, self.camera_file)
        return {each for each in topics if each}

    @property
    def all(self) -> set[str]:
        """The topics to read once."""
        topics = (self.gravity, self.pose, *self.transforms, *self.imus)
        return self.of_frames | {each for each in topics if each}


def find_topics(path: Path, bag: BagFile, named: ImageTopics | None) -> BagTopics:
    """Choose the topics.

    Args:
        named: The topics of color and depth, if the user names them.

    Raises:
        InputError: A topic is missing, or there are several candidates.
    """
    types = bag.types
    images = [topic for topic, kind in types.items() if kind in IMAGE_TYPES]
    if not images:
        raise InputError(f"{path}: {_describe_other_topics(bag)}")

    def one(suffix: str, kind: str) -> str:
        return next((t for t, k in types.items() if k == kind and t.endswith(suffix)), "")

    # A recording of this program may have images of other cameras, which were converted with it.
    frame_stamps = one("/frame_stamps", STRING_SCHEMA)
    namespace = frame_stamps.removesuffix("/frame_stamps")
    own = [each for each in images if image_base(each) in {namespace + n for n in OWN_IMAGES}]
    color, depth = named or _find_images(path, own if frame_stamps and own else images)
    is_own = bool(frame_stamps) and color in own and depth in own
    for topic in (color, depth):
        if topic not in images:
            raise InputError(f"{path}: no images at topic {topic}; {_list(images)}")
    poses = [t for t, kind in types.items() if kind in POSE_TYPES]
    return BagTopics(
        color,
        depth,
        _info_topic(color, types),
        _info_topic(depth, types),
        tuple(t for t, kind in types.items() if kind in TF_MESSAGE_TYPES),
        tuple(t for t, kind in types.items() if kind == IMU_SCHEMA),
        one(f"{namespace}/gravity", VECTOR_SCHEMA) if is_own else "",
        next((t for t in poses if any(word in t.lower() for word in TRUTH_WORDS)), ""),
        frame_stamps if is_own else "",
        one("/camera_file", STRING_SCHEMA) if is_own or not frame_stamps else "",
    )


def image_base(topic: str) -> str:
    """Return an image's topic without the part that names its compression."""
    base, _, last = topic.rpartition("/")
    return base if last in COMPRESSED_PARTS else topic


def is_rectified(topic: str) -> bool:
    """Whether a topic's images are undistorted, by its name."""
    return "rect" in image_base(topic).rpartition("/")[2]


def is_named_registered(topic: str) -> bool:
    """Whether a topic of depth says that it is registered to color."""
    return "registered" in topic or "aligned" in topic


def _info_topic(image: str, types: Mapping[str, str]) -> str:
    """Return the CameraInfo beside an image, or inside its topic."""
    base = image_base(image)
    candidates = (f"{base.rpartition('/')[0]}/camera_info", f"{base}/camera_info")
    return next((each for each in candidates if types.get(each) == CAMERA_INFO_SCHEMA), "")


def _find_images(path: Path, images: list[str]) -> ImageTopics:
    depths = [each for each in images if "depth" in each.lower()]
    colors = [each for each in images if not any(word in each.lower() for word in NO_COLOR_WORDS)]
    if not depths or not colors:
        kind = "depth" if colors else "color"
        raise InputError(f"{path}: no topic of {kind} images; {_list(images)}")
    depth = _best(path, depths, _depth_rank, images)
    space = depth.split("/")[1] if depth.startswith("/") else ""
    near = [each for each in colors if each.startswith(f"/{space}/")] or colors
    return _best(path, near, _color_rank, images), depth


def _depth_rank(topic: str) -> tuple[int, ...]:
    return (not is_named_registered(topic), *_form_rank(topic, DEPTH_NAMES))


def _color_rank(topic: str) -> tuple[int, ...]:
    is_named = "rgb" in topic.lower() or "color" in topic.lower()
    is_gray = "mono" in topic or "gray" in topic
    return (not is_named, is_gray, *_form_rank(topic, COLOR_NAMES))


def _form_rank(topic: str, names: tuple[str, ...]) -> tuple[int, ...]:
    """Rank the last part of a topic: raw before compressed, because it loses nothing."""
    base = image_base(topic)
    name = base.rpartition("/")[2]
    return (names.index(name) if name in names else len(names), base != topic)


def _best(
    path: Path, topics: list[str], rank: Callable[[str], tuple[int, ...]], images: list[str]
) -> str:
    """Return the topic of the lowest rank. Raises InputError if there are two."""
    first, *others = sorted(topics, key=rank)
    if others and rank(others[0]) == rank(first):
        raise InputError(f"{path}: {first} and {others[0]} are equally good; {_list(images)}")
    return first


def _list(images: list[str]) -> str:
    return f"name two of these with --topics COLOR DEPTH: {', '.join(sorted(images))}"


MAX_LISTED_TOPICS = 4


def _describe_other_topics(bag: BagFile) -> str:
    """Describe a file without images by what it holds."""
    topics = {**bag.unread, **bag.types}
    if not topics:
        return "holds no messages; is it a complete recording?"
    likely_first = sorted(topics, key=lambda topic: ("mage" not in topics[topic], topic))
    listed = [f"{topic} ({topics[topic]})" for topic in likely_first[:MAX_LISTED_TOPICS]]
    if len(topics) > MAX_LISTED_TOPICS:
        listed.append(f"{len(topics) - MAX_LISTED_TOPICS} more")
    return (
        f"holds no images that can be read, but {', '.join(listed)}; images are sensor_msgs/Image "
        "or CompressedImage, in MCAP as ROS 2 writes them (encoding cdr): convert them to these"
    )


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
        infos: First CameraInfo by topic.
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
    for key, message in number_messages(bag.messages(topics.all)):
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
