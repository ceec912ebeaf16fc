"""The output of frames: encodes and publishes, on its own thread, what somebody subscribes to."""

import logging
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import zenoh
import zenoh.shm

from drivers.core.flow_control import DropOldestQueue, Throttle, WorkerThread
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.frames import (
    FrameKeyPublisher,
    FrameOutputConfig,
    FrameTopic,
    make_topics,
)
from vo_service.outputs.zenoh import endpoints_without_roles
from vo_service.types import OdometryUpdate
from vo_service.types.messages import frame_attachment
from vo_service.types.outputs import OutputBase

if TYPE_CHECKING:  # loaded only if it is enabled
    from vo_service.outputs.frames.ros2 import RosFrames

logger = logging.getLogger(__name__)

# Three raw color and depth images: what readers hold, and what is on its way to them. Zenoh locks
# the pool in the memory of each process that maps it, and Linux allows a user 8 MB of that.
POOL_BYTES = 6 << 20
# Smaller messages go with the others through the socket.
MIN_SHARED_BYTES = 16 << 10


class SharedPayloads:
    """Places payloads in a pool of shared memory while there is room in it.

    A reader on this computer then maps the payload instead of receiving it; one elsewhere, or
    without rights to the memory, receives it as usual. The pool is made for the first payload. If
    that fails, as with a small or read-only /dev/shm, payloads stay plain bytes.
    """

    def __init__(self, pool_bytes: int = POOL_BYTES) -> None:
        self._pool_bytes = pool_bytes
        self._pools: list[zenoh.shm.ShmProvider] | None = None

    def share(self, payload: bytes) -> zenoh.ZBytes:
        """Return the payload to publish; it may be published several times."""
        if len(payload) < MIN_SHARED_BYTES:
            return zenoh.ZBytes(payload)
        if self._pools is None:
            self._pools = self._make_pools()
        for pool in self._pools:
            try:
                buffer = pool.alloc(len(payload), zenoh.shm.GarbageCollect())
            except zenoh.ZError:  # readers hold all of it
                break
            buffer[:] = payload
            return zenoh.ZBytes(buffer)
        return zenoh.ZBytes(payload)

    def _make_pools(self) -> list[zenoh.shm.ShmProvider]:
        """Return the pool; nothing if this computer has no room for it."""
        try:
            pool = zenoh.shm.ShmProvider.default_backend(self._pool_bytes)
            pool.alloc(1, zenoh.shm.GarbageCollect())  # makes Zenoh's own segments
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # without memory to lock, Zenoh panics: no Exception
            logger.info("frames: no shared memory: %s", str(error).partition("\n")[0])
            return []
        return [pool]


class FrameTopicPublisher:
    """Encodes one topic once for all its keys, if any of them is wanted."""

    def __init__(self, topic: FrameTopic, keys: Sequence[FrameKeyPublisher]) -> None:
        self._topic = topic
        self._keys = keys

    @property
    def is_wanted(self) -> bool:
        """Whether somebody subscribes."""
        return any(key.is_wanted for key in self._keys)

    def publish(
        self, update: OdometryUpdate, attachment: bytes, shared_payloads: SharedPayloads
    ) -> None:
        """Encode and publish the topic of a frame.

        Args:
            update: The frame and its pose.
            attachment: The attachment of its pose.
            shared_payloads: Puts a message into shared memory, once for all keys.

        Raises:
            ValueError: The frame cannot be encoded.
            zenoh.ZError: Publishing fails.
        """
        keys = [key for key in self._keys if key.is_wanted]
        for payload in self._topic.encode(update) if keys else ():
            shared = shared_payloads.share(payload)
            for key in keys:
                key.put(shared, attachment)


def plain_key(session: zenoh.Session, topic: FrameTopic, prefix: str) -> FrameKeyPublisher:
    """Declare the topic's own key."""
    encoding = (
        zenoh.Encoding.APPLICATION_CDR.with_schema(topic.schema)
        if topic.schema
        else zenoh.Encoding.APPLICATION_JSON
    )
    return FrameKeyPublisher(session, f"{prefix}/{topic.name}", encoding, lambda own: own)


CLOSE_TIMEOUT_S = 2.0
# A pose reaches its readers first: copying images would compete with them for a processor.
POSE_LEAD_S = 0.002


class FrameOutput(OutputBase):
    """Publishes frames on the session of the poses; `docs/reference/messages.md` has the keys.

    `ZenohOutput` calls `declare` and `queue`. Without a subscriber, an update costs a microsecond.
    A slow thread or link loses frames.
    """

    def __init__(self, config: FrameOutputConfig) -> None:
        self._config = config
        self._topics = make_topics(config.frames)
        self._publishers: list[FrameTopicPublisher] = []
        self._ros2: RosFrames | None = None
        self._shared_payloads = SharedPayloads()
        self._throttle = Throttle(1.0 / config.frames.max_hz)
        self.warning = ""
        # One frame is being sent while the next one waits.
        self._worker: WorkerThread[OdometryUpdate] = WorkerThread(
            "frames", DropOldestQueue(1), self._publish, lambda: None
        )

    def declare(self, session: zenoh.Session) -> None:
        """Publish on this session from now on."""
        prefix = self._config.prefix
        self._ros2 = self._open_ros2(session)
        self._publishers = [
            FrameTopicPublisher(
                topic,
                [
                    plain_key(session, topic, prefix),
                    *(() if self._ros2 is None else self._ros2.declare_topic(topic)),
                ],
            )
            for topic in self._topics
        ]
        if self._ros2 is not None:
            self._ros2.declare_transform()

    def _open_ros2(self, session: zenoh.Session) -> "RosFrames | None":
        if not self._config.ros2.enabled:
            return None
        from vo_service.outputs.frames.ros2 import RosFrames

        return RosFrames(session, self._config)

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
