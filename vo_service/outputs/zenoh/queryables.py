"""Queryables for readers; separate threads reply from memory."""

import json
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import zenoh

from drivers.core.flow_control import TokenBucket
from vo_service.ros_messages.navigation import ODOMETRY_SCHEMA, TRANSFORM_SCHEMA
from vo_service.types.commands import CommandError, ErrorCode
from vo_service.types.messages import MESSAGE_SCHEMA, ErrorReply, encode_message

logger = logging.getLogger(__name__)


CDR = zenoh.Encoding.APPLICATION_CDR.with_schema(ODOMETRY_SCHEMA)
CDR_TRANSFORM = zenoh.Encoding.APPLICATION_CDR.with_schema(TRANSFORM_SCHEMA)
JSON = zenoh.Encoding.APPLICATION_JSON
# Above this, Zenoh drops the oldest query, without any Python code.
MAX_PENDING_QUERIES = 16
# Many queries must not take CPU time from the poses.
MAX_REPLIES_PER_SECOND = 100.0

QueryHandler = Callable[[zenoh.Query], None]


class LatestMessages:
    """The latest messages, for queries. One thread writes, others read."""

    def __init__(self) -> None:
        self.pose: tuple[bytes, bytes] | None = None  # CDR, attachment
        self.map_odom: tuple[bytes, bytes] | None = None  # the same; None without a map
        self.status: bytes | None = None


def serve_queryable(session: zenoh.Session, key: str, handler: QueryHandler) -> threading.Thread:
    """Reply to the queries of a key, one after another, on a thread that ends with the session.

    Queries wait in Zenoh, not in Python, so a flood of them does not delay the poses. A dropped
    query gets no reply.

    Args:
        session: The open session.
        key: Zenoh key.
        handler: Replies to one query.

    Returns:
        The thread.
    """
    queryable = session.declare_queryable(key, zenoh.handlers.RingChannel(MAX_PENDING_QUERIES))
    thread = threading.Thread(
        target=_serve, args=(queryable, handler), name=f"zenoh-{key}", daemon=True
    )
    thread.start()
    return thread


def reply(
    query: zenoh.Query,
    key: str,
    payload: bytes,
    encoding: zenoh.Encoding = JSON,
    attachment: bytes | None = None,
) -> None:
    """Send the reply and close the query.

    Args:
        query: The query.
        key: Zenoh key of the reply.
        payload: Content of the reply.
        encoding: Encoding of the payload.
        attachment: JSON attachment, if there is one.
    """
    with suppress(zenoh.ZError):  # the session has closed
        query.reply(key, payload, encoding=encoding, attachment=attachment)
    query.drop()  # type: ignore[no-untyped-call]


def reply_error(query: zenoh.Query, error: CommandError) -> None:
    """Send an error reply and close the query."""
    with query, suppress(zenoh.ZError):  # the session has closed
        query.reply_err(encode_message(ErrorReply(error.code, str(error))), encoding=JSON)


def _serve(queryable: zenoh.Queryable[zenoh.Handler[zenoh.Query]], handler: QueryHandler) -> None:
    rate_limit = TokenBucket(MAX_REPLIES_PER_SECOND)
    # Not `queryable.recv`: it would keep the queryable borrowed, and closing would fail.
    queries = queryable.handler
    while True:
        time.sleep(rate_limit.seconds_until_next())
        try:
            query = queries.recv()
        except zenoh.ZError:  # the session has closed
            return
        rate_limit.try_acquire()
        try:
            handler(query)
        except Exception as error:  # one failed query must not end the thread
            logger.error("zenoh: cannot reply to %s: %s", query.key_expr, error)
            reply_error(
                query, CommandError(ErrorCode.FAILED, "an error inside the service; see its log")
            )


@dataclass(frozen=True)
class Queryables:
    """Queryables for any reader: last pose, map->odom transform, last status, schemas."""

    prefix: str
    latest: LatestMessages

    def declare(self, session: zenoh.Session) -> list[threading.Thread]:
        """Start to reply; return the threads."""
        handlers = {
            "latest": self._reply_latest,
            "map_odom": self._reply_map_odom,
            "status": self._reply_status,
            "schema": self._reply_schema,
        }
        return [
            serve_queryable(session, f"{self.prefix}/{name}", handler)
            for name, handler in handlers.items()
        ]

    def _reply_latest(self, query: zenoh.Query) -> None:
        if self.latest.pose is None:
            reply_error(query, CommandError(ErrorCode.NOT_POSSIBLE, "there is no pose yet"))
            return
        payload, attachment = self.latest.pose
        reply(query, f"{self.prefix}/latest", payload, CDR, attachment)

    def _reply_map_odom(self, query: zenoh.Query) -> None:
        if self.latest.map_odom is None:
            reply_error(query, CommandError(ErrorCode.NOT_POSSIBLE, "there is no map yet"))
            return
        payload, attachment = self.latest.map_odom
        reply(query, f"{self.prefix}/map_odom", payload, CDR_TRANSFORM, attachment)

    def _reply_status(self, query: zenoh.Query) -> None:
        if self.latest.status is None:
            reply_error(query, CommandError(ErrorCode.NOT_POSSIBLE, "there is no status yet"))
            return
        reply(query, f"{self.prefix}/status", self.latest.status)

    def _reply_schema(self, query: zenoh.Query) -> None:
        # Imported by the first query: few ask for the schemas.
        from vo_service.outputs.zenoh.json_schemas import all_schemas

        content = {"schema": MESSAGE_SCHEMA, "schemas": all_schemas()}
        reply(query, f"{self.prefix}/schema", json.dumps(content).encode())
