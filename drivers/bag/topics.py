"""Which topics of a bag hold color and depth, and what belongs to them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.bag.bag_file import TF_MESSAGE_TYPES
from drivers.bag.image_messages import IMAGE_TYPES
from drivers.core.errors import InputError
from drivers.recording.recording import ImageTopics

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMU = "sensor_msgs/msg/Imu"
STRING = "std_msgs/msg/String"
VECTOR_STAMPED = "geometry_msgs/msg/Vector3Stamped"
POSE_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
)
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
    def all(self) -> set[str]:
        """The topics to read once, besides images."""
        infos = (self.color_info, self.depth_info)
        own = (self.gravity, self.frame_stamps, self.camera_file)
        topics = (*infos, *own, self.pose, *self.transforms, *self.imus)
        return {each for each in topics if each}


def find_topics(path: Path, types: Mapping[str, str], named: ImageTopics | None) -> BagTopics:
    """Choose the topics.

    Args:
        path: The file, for error messages.
        types: Type of each topic.
        named: The topics of color and depth, if the user names them.

    Raises:
        InputError: A topic is missing, or there are several candidates.
    """
    images = [topic for topic, kind in types.items() if kind in IMAGE_TYPES]
    color, depth = named or _find_images(path, images)
    for topic in (color, depth):
        if topic not in images:
            raise InputError(f"{path}: no images at topic {topic}; {_list(images)}")

    def one(suffix: str, kind: str) -> str:
        return next((t for t, k in types.items() if k == kind and t.endswith(suffix)), "")

    poses = [t for t, kind in types.items() if kind in POSE_TYPES]
    return BagTopics(
        color,
        depth,
        _info_topic(color, types),
        _info_topic(depth, types),
        tuple(t for t, kind in types.items() if kind in TF_MESSAGE_TYPES),
        tuple(t for t, kind in types.items() if kind == IMU),
        one("/gravity", VECTOR_STAMPED) if one("/frame_stamps", STRING) else "",
        next((t for t in poses if any(word in t.lower() for word in TRUTH_WORDS)), ""),
        one("/frame_stamps", STRING),
        one("/camera_file", STRING),
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
    return next((each for each in candidates if types.get(each) == CAMERA_INFO), "")


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
    if not images:
        return "it holds no images"
    return f"name two of these with --topics COLOR DEPTH: {', '.join(sorted(images))}"
