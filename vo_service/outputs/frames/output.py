"""The output of frames: encodes on a thread of its own what somebody subscribes to."""

import logging
import time
from dataclasses import dataclass

import zenoh

from drivers.core.flow_control import DropOldestQueue, Throttle, WorkerThread
from drivers.core.geometry import Array
from vo_service.config_tables import FramesConfig, Ros2Config, ZenohConfig
from vo_service.outputs.frames.publisher import (
    FrameKeyPublisher,
    FrameTopicPublisher,
    RosKeys,
    plain_key,
)
from vo_service.outputs.frames.shared_memory import SharedPayloads
from vo_service.outputs.frames.topics import FrameTopic, frame_attachment, make_topics
from vo_service.outputs.zenoh.ros2 import (
    RosNode,
    RosTopic,
    StaticTransformPublisher,
    node_name,
    ros_type,
)
from vo_service.outputs.zenoh.session_check import endpoints_without_roles
from vo_service.ros_messages.navigation import TransformMessage
from vo_service.types import OdometryUpdate
from vo_service.types.messages import Status

logger = logging.getLogger(__name__)

CLOSE_TIMEOUT_S = 2.0
# Numbers of the publishers in the ROS node; those of the poses and of /tf come before.
FIRST_ROS_NUMBER = 10
ROS_DEPTH = 1


@dataclass(frozen=True)
class FrameOutputConfig:
    """Configuration of the output.

    Attributes:
        prefix: Prefix of the keys.
        frames: Rate, coding and frame of the camera.
        T_base_camera: 4x4 pose of the optical camera in the base.
        base_frame_id: Frame of the base, for ROS 2.
        ros2: Topics for ROS 2.
    """

    prefix: str
    frames: FramesConfig
    T_base_camera: Array
    base_frame_id: str = "base_link"
    ros2: Ros2Config = Ros2Config()  # noqa: RUF009 (frozen)


class FrameOutput:
    """Publishes frames on the session of the poses; `docs/reference/messages.md` has the keys.

    `ZenohOutput` calls `declare` and `queue`. Without a subscriber, an update costs a microsecond.
    A slow thread or link loses frames.
    """

    def __init__(self, config: FrameOutputConfig) -> None:
        self._config = config
        self._topics = make_topics(config.frames)
        self._publishers: list[FrameTopicPublisher] = []
        self._ros_topics: list[RosKeys] = []  # keep their tokens declared
        self._static_transforms: list[StaticTransformPublisher] = []
        self._shared_payloads = SharedPayloads()
        self._throttle = Throttle(1.0 / config.frames.max_hz)
        self.warning = ""
        # One frame is being sent while the next one waits.
        self._worker: WorkerThread[OdometryUpdate] = WorkerThread(
            "frames", DropOldestQueue(1), self._publish, lambda: None
        )

    def declare(self, session: zenoh.Session) -> None:
        """Publish on this session from now on."""
        ros2, self._ros_topics = self._config.ros2, []
        node = RosNode(ros2.domain_id, str(session.zid()), node_name(self._config.prefix))
        self._publishers = [
            FrameTopicPublisher(
                topic,
                [
                    plain_key(session, topic, self._config.prefix),
                    *self._ros_keys(session, node, number, topic),
                ],
            )
            for number, topic in enumerate(self._topics, FIRST_ROS_NUMBER)
        ]
        if ros2.enabled and ros2.tf:
            number = FIRST_ROS_NUMBER + len(self._topics)
            self._static_transforms = [
                StaticTransformPublisher(session, node, number, self._camera_transform())
            ]

    def _ros_keys(
        self, session: zenoh.Session, node: RosNode, number: int, topic: FrameTopic
    ) -> list[FrameKeyPublisher]:
        ros2 = self._config.ros2
        if not ros2.enabled or not topic.ros_name:
            return []
        name = f"{ros2.namespace}/{topic.ros_name}"
        ros_topic = RosTopic(name, ros_type(topic.schema), ROS_DEPTH)
        keys = RosKeys(session, node, number, ros_topic)
        self._ros_topics.append(keys)
        return keys.publishers

    def _camera_transform(self) -> TransformMessage:
        config = self._config
        return TransformMessage(
            time.time(), config.base_frame_id, config.frames.frame_id, config.T_base_camera
        )

    @property
    def dropped(self) -> int:
        """Number of frames that newer ones replaced before they were encoded."""
        return self._worker.dropped

    def on_update(self, update: OdometryUpdate) -> None:
        """Ignore the update: its frame is queued once its pose is sent."""

    def queue(self, update: OdometryUpdate) -> None:
        """Queue the frame if somebody subscribes.

        Called once the pose is sent: copying images holds Python's lock, which would delay it.
        """
        is_wanted = any(publisher.is_wanted for publisher in self._publishers)
        if is_wanted and self._throttle.allow(update.stamp_s):
            self._worker.put(update)

    def on_status(self, status: Status) -> None:
        """Ignore the status."""

    def close(self) -> None:
        """Send the frame that waits."""
        self._worker.close(CLOSE_TIMEOUT_S)

    def _publish(self, update: OdometryUpdate) -> None:
        attachment = frame_attachment(update, self._config.T_base_camera)
        try:
            for publisher in self._publishers:
                publisher.publish(update, attachment, self._shared_payloads)
        except (ValueError, zenoh.ZError) as error:
            self.warning = f"frames: a frame could not be published: {error}"
            raise
        self.warning = ""


def open_frame_outputs(config: FrameOutputConfig, zenoh_config: ZenohConfig) -> list[FrameOutput]:
    """Open the output; return nothing if frames are not to be published.

    Raises:
        InputError: The configuration of Zenoh is not valid.
    """
    is_enabled = config.frames.enabled
    if is_enabled is None:
        exposed = endpoints_without_roles(zenoh_config)
        is_enabled = not exposed
        if exposed:
            logger.warning(
                "frames: not published: anyone in the network could see them at %s; set "
                "frames.enabled, or see docs/guide/remote-access.md",
                ", ".join(exposed),
            )
    return [FrameOutput(config)] if is_enabled else []
