"""Payloads in shared memory."""

import logging

import zenoh
import zenoh.shm

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
