"""What readers may ask for: answered from memory, on threads that the loop knows nothing of."""

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import zenoh

from vo_service.outputs.cdr import SCHEMA
from vo_service.outputs.cdr_transform import TRANSFORM_SCHEMA
from vo_service.outputs.zenoh_messages import answer_payload, error_payload
from vo_service.outputs.zenoh_schemas import all_schemas
from vo_service.token_bucket import TokenBucket
from vo_service.types import CommandError, ErrorCode

logger = logging.getLogger(__name__)

CDR = zenoh.Encoding.APPLICATION_CDR.with_schema(SCHEMA)
CDR_TRANSFORM = zenoh.Encoding.APPLICATION_CDR.with_schema(TRANSFORM_SCHEMA)
JSON = zenoh.Encoding.APPLICATION_JSON
# Zenoh gives up the oldest question that waits when there are more; that costs us no Python.
MOST_WAITING = 16
# Answering must not take the processor away from the poses, whoever asks how often.
ANSWERS_PER_SECOND = 100.0

Answer = Callable[[zenoh.Query], None]


class Memory:
    """The newest messages, for those who ask. Written by one thread, read by others."""

    def __init__(self) -> None:
        self.pose: tuple[bytes, bytes] | None = None  # CDR, attachment
        self.map_odom: tuple[bytes, bytes] | None = None  # the same; None where there is no map
        self.status: bytes | None = None


def answer_questions(session: zenoh.Session, key: str, answer: Answer) -> threading.Thread:
    """Answer all questions to a key, one after another, on a thread that ends with the session.

    Questions wait in Zenoh, not in Python: a flood of them costs the poses nothing. An asker whose
    question is given up gets no answer.
    """
    queryable = session.declare_queryable(key, zenoh.handlers.RingChannel(MOST_WAITING))
    thread = threading.Thread(
        target=_answer_all, args=(queryable, answer), name=f"zenoh-{key}", daemon=True
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
    """Answer, and be done with the question."""
    with suppress(zenoh.ZError):  # the session has closed
        query.reply(key, payload, encoding=encoding, attachment=attachment)
    query.drop()  # type: ignore[no-untyped-call]


def refuse(query: zenoh.Query, error: CommandError) -> None:
    """Answer with an error, and be done with the question."""
    with query, suppress(zenoh.ZError):  # the session has closed
        query.reply_err(error_payload(error), encoding=JSON)


def _answer_all(queryable: zenoh.Queryable[zenoh.Handler[zenoh.Query]], answer: Answer) -> None:
    pace = TokenBucket(ANSWERS_PER_SECOND)
    # Not `queryable.recv`: it would keep the queryable borrowed, and closing would fail.
    questions = queryable.handler
    while True:
        time.sleep(pace.next_s())
        try:
            query = questions.recv()
        except zenoh.ZError:  # the session has closed
            return
        pace.take()
        try:
            answer(query)
        except Exception as error:  # one question must not end the answers to all others
            logger.error("zenoh: %s cannot be answered: %s", query.key_expr, error)
            refuse(
                query, CommandError(ErrorCode.FAILED, "an error inside the service; see its log")
            )


@dataclass(frozen=True)
class Questions:
    """The keys that any reader may ask: the last pose, the map, the last status, the schemas."""

    prefix: str
    memory: Memory

    def declare(self, session: zenoh.Session) -> list[threading.Thread]:
        """Begin to answer; the threads that do."""
        answers = {
            "latest": self._latest,
            "map_odom": self._map_odom,
            "status": self._status,
            "schema": self._schema,
        }
        return [
            answer_questions(session, f"{self.prefix}/{name}", answer)
            for name, answer in answers.items()
        ]

    def _latest(self, query: zenoh.Query) -> None:
        if self.memory.pose is None:
            refuse(query, CommandError(ErrorCode.NOT_POSSIBLE, "there is no pose yet"))
            return
        payload, attachment = self.memory.pose
        reply(query, f"{self.prefix}/latest", payload, CDR, attachment)

    def _map_odom(self, query: zenoh.Query) -> None:
        if self.memory.map_odom is None:
            refuse(query, CommandError(ErrorCode.NOT_POSSIBLE, "there is no map yet"))
            return
        payload, attachment = self.memory.map_odom
        reply(query, f"{self.prefix}/map_odom", payload, CDR_TRANSFORM, attachment)

    def _status(self, query: zenoh.Query) -> None:
        if self.memory.status is None:
            refuse(query, CommandError(ErrorCode.NOT_POSSIBLE, "there is no status yet"))
            return
        reply(query, f"{self.prefix}/status", self.memory.status)

    def _schema(self, query: zenoh.Query) -> None:
        reply(query, f"{self.prefix}/schema", answer_payload({"schemas": all_schemas()}))
