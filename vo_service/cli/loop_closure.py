"""Loop closure over a recording, with the frames: the same frames give the same bits."""

from typing import TYPE_CHECKING

from vo_service.cli.kernels import run_warm_up
from vo_service.config import Config
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.synchronous_loop_closure import SynchronousLoopClosure


def make_loop_closure(
    config: Config, terminal: Terminal, stop: StopSignal
) -> "SynchronousLoopClosure":
    """Make loop closure with an empty map. Raises as `run_warm_up`."""
    from vo_service.slam.synchronous_loop_closure import (
        create_synchronous_loop_closure,
        warm_up_loop_closure,
    )

    run_warm_up(warm_up_loop_closure, terminal, stop)
    return create_synchronous_loop_closure(config.map)
