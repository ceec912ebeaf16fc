"""The output of frames: encodes on a thread of its own what somebody subscribes to."""

import logging
from dataclasses import dataclass

import zenoh

from drivers.core.geometry import Array
from drivers.core.queues import DropOldestQueue, WorkerThread
from drivers.core.rate_limit import Throttle
from vo_service.config_tables import FramesConfig, ZenohConfig
from vo_service.outputs.frames.publisher import FrameTopicPublisher, plain_key
from vo_service.outputs.frames.shared_memory import SharedPayloads
from vo_service.outputs.frames.topics import frame_attachment, make_topics
from vo_service.outputs.zenoh.session_check import endpoints_without_roles
from vo_service.types import OdometryUpdate, Status

logger = logging.getLogger(__name__)

CLOSE_TIMEOUT_S = 2.0


@dataclass(frozen=True)
class FrameOutputConfig:
    """Configuration of the output.

    Attributes:
        prefix: Prefix of the keys.
        frames: Rate, coding and frame of the camera.
        T_base_camera: 4x4 pose of the optical camera in the base.
    """

    prefix: str
    frames: FramesConfig
    T_base_camera: Array


class FrameOutput:
    """Publishes frames on the session of the poses; `docs/reference/messages.md` has the keys.

    Without a subscriber, an update costs the service's loop a microsecond. A slow thread or link
    loses frames.
    """

    def __init__(self, config: FrameOutputConfig) -> None:
        self._config = config
        self._topics = make_topics(config.frames)
        self._publishers: list[FrameTopicPublisher] = []
        self._shared_payloads = SharedPayloads()
        self._throttle = Throttle(1.0 / config.frames.max_hz)
        self.warning = ""
        # One frame is being sent while the next one waits.
        self._worker: WorkerThread[OdometryUpdate] = WorkerThread(
            "frames", DropOldestQueue(1), self._publish, lambda: None
        )

    def declare(self, session: zenoh.Session) -> None:
        """Publish on this session from now on."""
        self._publishers = [
            FrameTopicPublisher(topic, [plain_key(session, topic, self._config.prefix)])
            for topic in self._topics
        ]

    @property
    def dropped(self) -> int:
        """Number of frames that newer ones replaced before they were encoded."""
        return self._worker.dropped

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue the frame if somebody subscribes."""
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
