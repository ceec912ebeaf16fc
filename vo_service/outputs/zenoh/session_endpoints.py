"""What is declared on a session: queryables, commands, and the publishers of poses and status.

The queryables reply with the latest messages and their schemas.
"""

import json
import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import zenoh
import zenoh.ext

from drivers.core.queues import BlockingQueue, WorkerThread
from drivers.core.rate_limits import TokenBucket
from drivers.ros_messages.navigation import OCCUPANCY_GRID_SCHEMA, ODOMETRY_SCHEMA, TRANSFORM_SCHEMA
from vo_service.config_tables import CommandConfig, FrameIds
from vo_service.control import CommandFuture, CommandQueue
from vo_service.outputs.zenoh.receiver import MAX_PENDING, start_receiver
from vo_service.outputs.zenoh.session import declare_latched_publisher
from vo_service.types.commands import (
    MAX_PAYLOAD_BYTES,
    CommandError,
    ErrorCode,
    NotPossibleError,
    parse_command,
)
from vo_service.types.messages import MESSAGE_SCHEMA, ErrorReply, encode_message
from vo_service.types.odometry_update import OdometryUpdate

logger = logging.getLogger(__name__)


CDR = zenoh.Encoding.APPLICATION_CDR.with_schema(ODOMETRY_SCHEMA)
CDR_GRID = zenoh.Encoding.APPLICATION_CDR.with_schema(OCCUPANCY_GRID_SCHEMA)
CDR_TRANSFORM = zenoh.Encoding.APPLICATION_CDR.with_schema(TRANSFORM_SCHEMA)
JSON = zenoh.Encoding.APPLICATION_JSON
# Many queries must not take CPU time from the poses.
MAX_REPLIES_PER_SECOND = 100.0

QueryHandler = Callable[[zenoh.Query], None]


# Makes a message: CDR or JSON, and its attachment.
Encode = Callable[[], tuple[bytes, bytes | None]]
# By the key below the prefix. One thread writes, others read.
LatestMessages = dict[str, Encode]


def serve_queryable(session: zenoh.Session, key: str, handler: QueryHandler) -> threading.Thread:
    """Reply to the queries of a key. A dropped query gets no reply.

    Returns:
        The thread.
    """
    queryable = session.declare_queryable(key, zenoh.handlers.RingChannel(MAX_PENDING))
    return start_receiver(queryable, key, MAX_REPLIES_PER_SECOND, partial(_serve, handler))


def reply(
    query: zenoh.Query,
    key: str,
    payload: bytes,
    encoding: zenoh.Encoding = JSON,
    attachment: bytes | None = None,
) -> None:
    """Send the reply and close the query.

    Args:
        attachment: JSON attachment, if there is one.
    """
    with suppress(zenoh.ZError):  # the session has closed
        query.reply(key, payload, encoding=encoding, attachment=attachment)
    query.drop()  # type: ignore[no-untyped-call]


def reply_error(query: zenoh.Query, error: CommandError) -> None:
    """Send an error reply and close the query."""
    with query, suppress(zenoh.ZError):  # the session has closed
        query.reply_err(encode_message(ErrorReply(error.code, str(error))), encoding=JSON)


def _serve(handler: QueryHandler, query: zenoh.Query) -> None:
    try:
        handler(query)
    except Exception as error:  # one failed query must not end the thread
        logger.error("zenoh: cannot reply to %s: %s", query.key_expr, error)
        reply_error(
            query, CommandError(ErrorCode.FAILED, "an error inside the service; see its log")
        )


# Of the messages that can be queried: their encoding, and why there is none.
QUERYABLE_MESSAGES = {
    "latest": (CDR, "there is no pose yet"),
    "map_odom": (CDR_TRANSFORM, "there is no map yet"),
    "map": (
        CDR_GRID,
        "there is no occupancy grid yet; it needs the camera's height in T_base_camera",
    ),
    "status": (JSON, "there is no status yet"),
}


@dataclass(frozen=True)
class Queryables:
    """Queryables for any reader: last pose, map->odom transform, grid, last status, schemas."""

    prefix: str
    latest: LatestMessages

    def declare(self, session: zenoh.Session) -> list[threading.Thread]:
        """Start to reply; return the threads."""
        handlers: dict[str, QueryHandler] = {
            name: partial(self._reply_latest, name) for name in QUERYABLE_MESSAGES
        }
        handlers["schema"] = self._reply_schema
        return [
            serve_queryable(session, f"{self.prefix}/{name}", handler)
            for name, handler in handlers.items()
        ]

    def _reply_latest(self, name: str, query: zenoh.Query) -> None:
        encoding, absence = QUERYABLE_MESSAGES[name]
        encode = self.latest.get(name)
        if encode is None:
            reply_error(query, NotPossibleError(absence))
            return
        payload, attachment = encode()
        reply(query, f"{self.prefix}/{name}", payload, encoding, attachment)

    def _reply_schema(self, query: zenoh.Query) -> None:
        # Imported by the first query: few ask for the schemas.
        from vo_service.outputs.zenoh.json_schemas import all_schemas

        content = {"schema": MESSAGE_SCHEMA, "schemas": all_schemas()}
        reply(query, f"{self.prefix}/schema", json.dumps(content).encode())


# The loop handles commands several times a second; after this long, it hangs.
RESULT_TIMEOUT_S = 5.0
LOG_PERIOD_S = 60.0
CLOSE_TIMEOUT_S = 0.5


class NullCommandEndpoint:
    """Endpoint without commands."""

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Declare nothing."""
        return []

    def configure(self, settings: CommandConfig) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class _PendingCommand:
    """A command in the loop's queue, and the query that waits for its result."""

    query: zenoh.Query
    key: str
    future: CommandFuture


class CommandServer:
    """Server of all commands of `vo_service.types.commands`, with a rate limit.

    One queryable serves all names, so it can report an unknown command. One thread parses and
    refuses; another waits for the loop's results and sends the replies in order.
    """

    def __init__(self, command_queue: CommandQueue, per_second: float) -> None:
        self._command_queue = command_queue
        self._rate_limit = CommandRateLimit(per_second)
        self._replies: WorkerThread[_PendingCommand] = WorkerThread(
            "zenoh-answers", BlockingQueue(MAX_PENDING), _send_reply, lambda: None
        )

    def declare(self, session: zenoh.Session, prefix: str) -> list[threading.Thread]:
        """Start to reply on a new session; return the thread."""
        key_prefix = f"{prefix}/command/"
        return [serve_queryable(session, f"{key_prefix}*", partial(self._receive, key_prefix))]

    def configure(self, settings: CommandConfig) -> None:
        """Set a new rate limit."""
        self._rate_limit = CommandRateLimit(settings.per_second)

    def close(self) -> None:
        """Stop replying; pending commands get no reply."""
        self._replies.close(CLOSE_TIMEOUT_S)

    def _receive(self, key_prefix: str, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        if "*" in key:  # a wildcard query reads keys; it is not a command
            query.drop()  # type: ignore[no-untyped-call]
            return
        try:
            self._rate_limit.check()
            command = parse_command(key.removeprefix(key_prefix), _read_payload(query))
            self._replies.put(_PendingCommand(query, key, self._command_queue.submit(command)))
        except CommandError as error:
            reply_error(query, error)


# Receives commands, or refuses them all.
CommandEndpoint = CommandServer | NullCommandEndpoint


def _send_reply(pending: _PendingCommand) -> None:
    try:
        payload = encode_message(pending.future.result(RESULT_TIMEOUT_S))
    except CommandError as error:
        logger.info("zenoh: %s: %s", pending.key, error)
        reply_error(pending.query, error)
    except (TypeError, ValueError) as error:
        reply_error(
            pending.query, CommandError(ErrorCode.FAILED, f"its result is not JSON: {error}")
        )
    else:
        logger.info("zenoh: %s: done", pending.key)
        reply(pending.query, pending.key, payload)


def make_command_endpoint(settings: CommandConfig, command_queue: CommandQueue) -> CommandEndpoint:
    """Make the configured command endpoint."""
    return (
        CommandServer(command_queue, settings.per_second)
        if settings.enabled
        else NullCommandEndpoint()
    )


class CommandRateLimit:
    """Rate limit of commands, which logs refusals now and then. For one thread."""

    def __init__(self, per_second: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self._bucket = TokenBucket(per_second, now_s)
        self._now_s = now_s
        self._rejected = 0
        self._logged_s = float("-inf")

    def check(self) -> None:
        """Count one command. Raises CommandError (rate-limited) above the limit."""
        if self._bucket.try_acquire():
            return
        self._rejected += 1
        limit = f"more than {self._bucket.per_second:g} commands a second"
        if self._now_s() - self._logged_s >= LOG_PERIOD_S:
            logger.warning("zenoh: %s: refused %d (logged once a minute)", limit, self._rejected)
            self._logged_s, self._rejected = self._now_s(), 0
        raise CommandError(ErrorCode.RATE_LIMITED, f"{limit}; wait, then try again")


def _read_payload(query: zenoh.Query) -> bytes:
    """Read the payload if it is small enough. Raises CommandError (bad-request)."""
    if not query.parameters.is_empty():
        raise CommandError(
            ErrorCode.BAD_REQUEST, "send arguments as JSON in the payload, not after a `?`"
        )
    payload = query.payload
    if payload is None:
        return b""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise CommandError(
            ErrorCode.BAD_REQUEST,
            f"the payload has {len(payload)} bytes; the limit is {MAX_PAYLOAD_BYTES}",
        )
    return payload.to_bytes()


# Subscribes to messages of the robot's base on a new session; returns the threads.
Subscribe = Callable[[zenoh.Session], list[threading.Thread]]


def subscribe_to_nothing(session: zenoh.Session) -> list[threading.Thread]:
    """Subscribe to nothing."""
    return []


THREAD_JOIN_TIMEOUT_S = 0.5


@dataclass(frozen=True)
class ExtraEndpoints:
    """Optional endpoints on the session.

    Attributes:
        commands: Receives commands.
        frame_ids: Names of the frames in the messages.
        subscriptions: Called with each new session; each subscribes and returns its threads.
        on_session: Called with each new session, to declare more on it.
        on_pose: Called with each update once its pose is sent, on the thread that sends poses.
    """

    commands: CommandEndpoint = field(default_factory=NullCommandEndpoint)
    frame_ids: FrameIds = FrameIds()  # noqa: RUF009 (frozen)
    subscriptions: Sequence[Subscribe] = ()
    on_session: Callable[[zenoh.Session], None] = lambda _: None
    on_pose: Callable[[OdometryUpdate], None] = lambda _: None


@dataclass(frozen=True)
class EndpointConfig:
    """Configuration of the endpoints on one session."""

    prefix: str
    congestion: zenoh.CongestionControl
    queryables: Queryables
    extra: ExtraEndpoints


class SessionEndpoints:
    """Publishers, queryables, commands and the liveliness token `alive` of one session.

    The token is declared last: a client that sees it finds everything else.
    """

    def __init__(self, session: zenoh.Session, config: EndpointConfig) -> None:
        self.session = session
        prefix = config.prefix
        self._odom = session.declare_publisher(
            f"{prefix}/odom",
            encoding=CDR,
            congestion_control=config.congestion,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._publishers: dict[str, zenoh.Publisher | zenoh.ext.AdvancedPublisher] = {
            "odom": self._odom,
            "map_odom": session.declare_publisher(
                f"{prefix}/map_odom",
                encoding=CDR_TRANSFORM,
                congestion_control=config.congestion,
                reliability=zenoh.Reliability.RELIABLE,
            ),
            "status": session.declare_publisher(
                f"{prefix}/status", encoding=JSON, congestion_control=config.congestion
            ),
        }
        self._prefix = prefix
        if "map" in config.queryables.latest:  # of an earlier session
            self.publish("map", *config.queryables.latest["map"]())
        self._threads = config.queryables.declare(session)
        self._threads += config.extra.commands.declare(session, prefix)
        for subscribe in config.extra.subscriptions:
            self._threads += subscribe(session)
        config.extra.on_session(session)
        self._alive = session.liveliness().declare_token(f"{prefix}/alive")

    def publish(self, name: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish a message under its key; the grid also for those who subscribe later."""
        if name not in self._publishers:  # until there is a grid
            key = f"{self._prefix}/{name}"
            self._publishers[name] = declare_latched_publisher(self.session, key, CDR_GRID)
        self._publishers[name].put(payload, attachment=attachment)

    def wait_for_subscriber(self, timeout_s: float) -> bool:
        """Wait until there is a subscriber to the poses; return False on timeout."""
        is_matched = threading.Event()

        def on_change(status: zenoh.MatchingStatus) -> None:
            if status.matching:
                is_matched.set()

        listener = self._odom.declare_matching_listener(on_change)
        try:
            return _has_subscriber(self._odom) or is_matched.wait(timeout_s)
        finally:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Withdraw the token and close the session."""
        parts: list[Callable[[], object]] = [self._alive.undeclare, self.session.close]
        for close in parts:
            with suppress(zenoh.ZError):  # a broken link
                close()
        # A thread that is still inside Zenoh when Python exits crashes the process.
        for thread in self._threads:
            thread.join(THREAD_JOIN_TIMEOUT_S)


def _has_subscriber(publisher: zenoh.Publisher) -> bool:
    # Zenoh's stub declares bool, but the value is an object that is always true.
    status: zenoh.MatchingStatus = publisher.matching_status  # type: ignore[assignment]
    return status.matching
