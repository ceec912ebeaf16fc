"""Frames of the virtual Kinect that are rendered when they are read."""

import os
from typing import TYPE_CHECKING

from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.sensors import RenderedImages

if TYPE_CHECKING:  # its kernels are slow to load; the renderer's process loads them
    from drivers.synthetic.renderer import Renderer


class OnDemandFrameProvider:
    """Renders each frame when it is read, and stores none. Frame 0 follows the last."""

    def __init__(self, config: SyntheticConfig, threads: int) -> None:
        self._config = config
        self._threads = threads or os.cpu_count() or 1
        self._renderers: list[Renderer] = []

    def prepare(self) -> None:
        """Start work that can be done in the background. Raises as `start`."""

    def start(self) -> None:
        """Start providing frames. Raises InputError or CameraError if that fails."""
        from drivers.synthetic.renderer import make_renderer

        if not self._renderers:
            self._renderers.append(make_renderer(self._config, self._threads))

    def wait_until_started(self, timeout_s: float) -> bool:
        """Wait until the first frame is rendered. Raises as `wait_for_newest`."""
        return True

    def wait_for_newest(self, first: int, last: int, timeout_s: float) -> int | None:
        """Wait for the newest rendered frame from `first` to `last`.

        Args:
            first: Number of the first frame that is wanted.
            timeout_s: Longest wait, s.

        Returns:
            Its number; None if none of them is rendered after `timeout_s`.

        Raises:
            InputError, CameraError: Rendering failed.
        """
        return last

    def read(self, seq: int) -> RenderedImages:
        """Read a frame; wait if it is not rendered yet. Raises as `wait_for_newest`."""
        return self._renderers[0].render(seq % self._config.frame_count)

    def close(self) -> None:
        """Stop. Safe to call twice."""
