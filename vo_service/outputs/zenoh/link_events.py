"""Log of connections to a session and of their ends."""

import logging

import zenoh

from vo_service.outputs.zenoh.access_denied_log import sanitize

logger = logging.getLogger(__name__)


def log_link_events(session: zenoh.Session) -> None:
    """Log each connection and its end at level INFO, with its certificate's common name."""
    session.info.declare_link_events_listener(_log_event, history=True)


def _log_event(event: zenoh.LinkEvent) -> None:
    link = event.link
    change = "connected" if event.kind == zenoh.SampleKind.PUT else "disconnected"
    name = link.auth_identifier or "unauthenticated"
    logger.info("zenoh: %s", sanitize(f"{name}, {link.dst}: {change}"))
