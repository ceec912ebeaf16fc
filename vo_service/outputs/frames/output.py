"""The output of frames: encodes and publishes, on its own thread, what somebody subscribes to."""

import logging
import time
from dataclasses import dataclass, replace

import zenoh
import zenoh.ext

from drivers.core.geometry import Array
from drivers.core.queues import DropOldestQueue, WorkerThread
from drivers.core.rate_limits import Throttle
from drivers.ros_messages.navigation import TRANSFORMS_SCHEMA, TransformMessage, encode_transforms
from vo_service.config_tables import FrameIds, FramesConfig, ZenohConfig
from vo_service.navigation.frame_scans import make_T_base_scan
from vo_service.outputs.frames.camera_transforms import camera_transforms
from vo_service.outputs.frames.publishers import FrameTopicPublisher
from vo_service.outputs.frames.shared_payloads import SharedPayloads
from vo_service.outputs.frames.topics import SCAN_TOPIC, make_topics
from vo_service.outputs.zenoh.addresses import endpoints_without_roles
from vo_service.outputs.zenoh.session import declare_latched_publisher
from vo_service.types.messages import frame_attachment
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import OutputBase

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class FrameOutputConfig:
    """Configuration of the output.

    Attributes:
        prefix: Prefix of the keys.
        frames: Rate and coding.
        has_scan: Whether to publish the scan; None = if images are published.
        T_base_camera: 4x4 pose of the optical camera in the base.
        frame_ids: Names of the frames.
    """

    prefix: str
    frames: FramesConfig
    T_base_camera: Array
    frame_ids: FrameIds = FrameIds()  # noqa: RUF009 (frozen)
    has_scan: bool | None = None


CLOSE_TIMEOUT_S = 2.0
STATIC_TRANSFORMS_ENCODING = zenoh.Encoding.APPLICATION_CDR.with_schema(TRANSFORMS_SCHEMA)
# A pose reaches its readers first: copying images would compete with them for a processor.
POSE_LEAD_S = 0.002


class FrameOutput(OutputBase):
    """Publishes frames on the session of the poses; `docs/reference/messages.md` has the keys.

    `ZenohOutput` calls `declare` and `queue`. Without a subscriber, an update costs a microsecond.
    A slow thread or link loses frames.
    """

    def __init__(self, config: FrameOutputConfig) -> None:
        self._config = config
        self._has_images = config.frames.enabled is not False
        self._topics = (
            make_topics(config.frames, config.frame_ids.camera_frame_id) if self._has_images else []
        )
        self._has_scan = config.has_scan is not False
        if self._has_scan:
            self._topics[1:1] = [SCAN_TOPIC]
        self._publishers: list[FrameTopicPublisher] = []
        self._static_transforms: zenoh.ext.AdvancedPublisher | None = None
        self._shared_payloads = SharedPayloads()
        self._throttle = Throttle(1.0 / config.frames.max_hz)
        self.warning = ""
        # One frame is being sent while the next one waits.
        self._worker: WorkerThread[OdometryUpdate] = WorkerThread(
            "frames", DropOldestQueue(1), self._publish, lambda: None
        )

    def declare(self, session: zenoh.Session) -> None:
        """Publish on this session from now on."""
        config = self._config
        self._publishers = [
            FrameTopicPublisher(session, config.prefix, topic) for topic in self._topics
        ]
        self._static_transforms = declare_latched_publisher(
            session, f"{config.prefix}/tf_static", STATIC_TRANSFORMS_ENCODING
        )
        self._static_transforms.put(encode_transforms(self._transforms()))

    def _transforms(self) -> list[TransformMessage]:
        config, names, stamp_s = self._config, self._config.frame_ids, time.time()
        transforms: list[TransformMessage] = []
        if self._has_images:
            transforms += camera_transforms(
                stamp_s, names.base_frame_id, names.camera_frame_id, config.T_base_camera
            )
        if self._has_scan:
            T_base_scan = make_T_base_scan(config.T_base_camera)
            transforms.append(
                TransformMessage(stamp_s, names.base_frame_id, names.scan_frame_id, T_base_scan)
            )
        return transforms

    @property
    def dropped(self) -> int:
        """Number of frames that newer ones replaced before they were encoded."""
        return self._worker.dropped

    def queue(self, update: OdometryUpdate) -> None:
        """Queue the frame if somebody subscribes.

        Called once the pose is sent: copying images holds Python's lock, which would delay it.
        """
        is_wanted = any(publisher.is_wanted for publisher in self._publishers)
        if is_wanted and self._throttle.allow(update.stamp_s):
            self._worker.put(update)

    def close(self) -> None:
        """Send the frame that waits."""
        self._worker.close(CLOSE_TIMEOUT_S)

    def _publish(self, update: OdometryUpdate) -> None:
        time.sleep(POSE_LEAD_S)
        attachment = frame_attachment(update, self._config.T_base_camera)
        try:
            for publisher in self._publishers:
                publisher.publish(update, attachment, self._shared_payloads)
        except (ValueError, zenoh.ZError) as error:
            self.warning = f"frames: a frame could not be published: {error}"
            raise
        self.warning = ""


def open_frame_outputs(config: FrameOutputConfig, zenoh_config: ZenohConfig) -> list[FrameOutput]:
    """Open the output; return nothing if neither frames nor the scan are to be published.

    Raises:
        InputError: The configuration of Zenoh is not valid.
    """
    has_images, has_scan = config.frames.enabled, config.has_scan
    exposed = endpoints_without_roles(zenoh_config) if has_images is None else []
    if exposed:
        logger.warning(
            "frames: not published: anyone in the network could see them at %s; set "
            "frames.enabled, or see docs/guide/remote-access.md",
            ", ".join(exposed),
        )
    if has_images is None:
        has_images = not exposed
    if has_scan is None:
        has_scan = has_images
    if not has_images and not has_scan:
        return []
    frames = replace(config.frames, enabled=has_images)
    return [FrameOutput(replace(config, frames=frames, has_scan=has_scan))]
