"""Write `vo_service/kernels/kernels.jsonl`: run each part, and list the kernels that it compiles.

Usage: .venv/bin/python -m scripts.list_kernels     after a change of a kernel's arguments
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from drivers.freenect.conversion import load_kernels
from drivers.synthetic.renderer import warm_up_renderer
from vo_service.frame_packing import compile_kernels
from vo_service.kernels.argument_types import to_json
from vo_service.kernels.kernel_list import KERNEL_FILE
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.keyframe_correction import correct_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.registry import METHODS, OWN_METHODS, MethodConfig
from vo_service.odometry.warm_up import WARM_UP_SEQUENCES, run_warm_up_frames
from vo_service.types.odometry import NullStageTimer

Signatures = list[tuple[str, list[Any]]]


def part_runs() -> dict[str, Callable[[], object]]:
    """Return what runs each part once."""
    from vo_service.navigation.grid_mapper import GridMapper
    from vo_service.navigation.robot_scan import RobotScanner
    from vo_service.reconstruction.warm_up import reconstruct_wall
    from vo_service.slam.synchronous_loop_closure import StationaryOdometry

    def ignore(_stage: str) -> None:
        pass

    methods: dict[str, Callable[[], object]] = {
        name: partial(run_warm_up_frames, partial(METHODS[name], MethodConfig(), NullStageTimer()))
        for name in OWN_METHODS
    }
    return methods | {
        "direct": partial(run_direct, methods["direct"]),
        "Kinect": load_kernels,
        "virtual Kinect": warm_up_renderer,
        "frame packing": compile_kernels,
        "loop closure": partial(run_warm_up_frames, StationaryOdometry),
        "reconstruction": partial(reconstruct_wall, ignore),
        "scan": RobotScanner.warm_up,
        "grid": GridMapper.warm_up,
    }


def run_direct(run_generated_frames: Callable[[], object]) -> None:
    """Run generated frames, and correct a keyframe: its timing is not learned from them."""
    run_generated_frames()
    frame = next(WARM_UP_SEQUENCES[0]())
    images = build_image_pyramid(frame)
    keyframe = make_keyframe(frame, images, np.eye(4), zero_motion(), ALL_STATIC)
    correct_keyframe(keyframe, frame.camera, images.shutter, zero_motion())


def compiled_signatures() -> Signatures:
    """Return all kernels of this process that are compiled or loaded."""
    dispatchers = {
        f"{each.py_func.__module__}.{each.py_func.__qualname__}": each
        for name, module in list(sys.modules.items())
        if name.startswith(("drivers.", "vo_service."))
        for each in vars(module).values()
        if hasattr(each, "overloads") and hasattr(each, "py_func")
    }
    return [
        (name, [to_json(argument) for argument in arguments])
        for name, each in sorted(dispatchers.items())
        for arguments in each.overloads
    ]


def loaded_signatures(run: Callable[[], object]) -> Signatures:
    """Run a part whose kernels are in the cache; return those that are loaded, in their order."""
    from numba.core import caching

    loaded: Signatures = []
    cache_class: Any = caching.FunctionCache
    load = cache_class._load_overload

    def load_and_list(cache: Any, arguments: Any, context: Any) -> Any:
        function = cache._py_func
        name = f"{function.__module__}.{function.__qualname__}"
        loaded.append((name, [to_json(argument) for argument in arguments]))
        return load(cache, arguments, context)

    cache_class._load_overload = load_and_list
    run()
    return loaded


def list_part(part: str) -> list[str]:
    """Return the lines of a part. It runs twice: one process compiles, the other one loads."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder}
        command = [sys.executable, "-m", "scripts.list_kernels", part]
        every, called = (
            json.loads(
                subprocess.run(
                    [*command, use], env=environment, stdout=subprocess.PIPE, check=True
                ).stdout
            )
            for use in ("compiled", "loaded")
        )
    inlined = [each for each in every if each not in called]
    uses = [(True, each) for each in called] + [(False, each) for each in inlined]
    return [json.dumps([part, is_called, *each]) + "\n" for is_called, each in uses]


def main() -> None:
    """List all parts, or print the kernels of one."""
    if len(sys.argv) > 1:
        part, use = sys.argv[1:]
        run = part_runs()[part]
        if use == "loaded":
            print(json.dumps(loaded_signatures(run)))
        else:
            run()
            print(json.dumps(compiled_signatures()))
        return
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        parts = threads.map(list_part, part_runs())
        KERNEL_FILE.write_text("".join(line for lines in parts for line in lines))


if __name__ == "__main__":
    main()
