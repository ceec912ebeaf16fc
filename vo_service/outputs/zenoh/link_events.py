"""Who connects to a session and who leaves it, in the log."""

import logging

import zenoh

from vo_service.outputs.zenoh.access_denied_log import sanitize

logger = logging.getLogger(__name__)


def log_link_events(session: zenoh.Session) -> None:
    """Log each connection and its end at level INFO, with the common name of its certificate."""
    session.info.declare_link_events_listener(_log_event, history=True)


def _log_event(event: zenoh.LinkEvent) -> None:
    link = event.link
    what = "connected" if event.kind == zenoh.SampleKind.PUT else "gone"
    logger.info("zenoh: %s", sanitize(f"{link.auth_identifier or 'nameless'}, {link.dst}: {what}"))
