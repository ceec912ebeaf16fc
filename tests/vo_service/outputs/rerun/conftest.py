"""The fixtures of the other outputs."""

from tests.vo_service.outputs.conftest import free_port

__all__ = ["free_port"]
