"""Load by a Kinect: the driver's CPU time by step, and CPU time and memory of all processes.

    python -m benchmarks kinect_load steps FOLDER [--frames 60] [--rounds 9]
    python -m benchmarks kinect_load processes FOLDER [--seconds 30]

FOLDER is a recording in TUM format that a simulated Kinect plays to the real libfreenect.
"""

import argparse
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, Variants, measure_cpu_ms, median, option
from benchmarks.kinect import make_kinect_without_motor
from benchmarks.service_load import descendants_of, measure_processor_use
from drivers.camera import RgbdFrame, new_images
from drivers.core.memory import limit_freed_memory
from drivers.core.process.record_ring import create_shared_memory
from drivers.freenect.bindings import COLOR_BAYER, DEPTH_11_BIT_PACKED
from drivers.freenect.conversion import ImageConversion
from drivers.rectify import Undistorter
from drivers.subprocess_camera.frame_ring import SLOT_BYTES, SLOT_COUNT, FrameSlots
from tests.resource_leaks import command_line_of, proportional_memory_kb
from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import FACTORY, IDENTITY, KinectSimulator, LoopMode
from tests.simulators.usb_frames import HEADER_BYTES, UsbFrames
from tests.vo_service.service_process import running_service

# Kernels are loaded, and the recorder's ring is full.
WARM_UP_S = 12.0
TYPICAL_DISTORTION = (0.2, -0.5, 0.0, 0.0, 0.3)
STEPS_TABLE = Table(32, "CPU ms:10.3f")
PROCESSES_TABLE = Table(
    10, "CPU ms per frame:18.2f", "% of a core:13.1f", "PSS MB:9.1f", "private:9.1f", "files:9.1f",
    "shared:9.1f",
)  # fmt: skip
FOLDER = option("folder", type=Path)

RawImage = NDArray[np.uint8]


@contextmanager
def simulated_kinect(folder: Path, frames: UsbFrames, registers: bool) -> Iterator[KinectSimulator]:
    """Plug in a Kinect that plays the frames forwards and backwards, and waits for its reader."""
    registration = FACTORY if registers else IDENTITY
    with KinectSimulator(folder, frames, registration=registration) as kinect:
        kinect.loop, kinect.waits_for_reader = LoopMode.THERE_AND_BACK, True
        yield kinect


def read_raw_images(frames: UsbFrames) -> list[tuple[RawImage, RawImage]]:
    """Read color (480, 640) and packed depth (422400,) of all frames."""
    depth_bytes, color_bytes = DEPTH_11_BIT_PACKED.shape[0], int(np.prod(COLOR_BAYER.shape))
    data = np.fromfile(frames.file, np.uint8)[HEADER_BYTES:].reshape(frames.count, -1)
    return [
        (frame[depth_bytes : depth_bytes + color_bytes].reshape(COLOR_BAYER.shape), packed)
        for frame, packed in zip(data, data[:, :depth_bytes].copy(), strict=True)
    ]


def make_steps(
    frame: RgbdFrame, conversion: ImageConversion, raw_images: Sequence[tuple[RawImage, RawImage]]
) -> Mapping[str, Callable[[], object]]:
    """Make each step of the driver, and the one of the service, as a function of the next frame."""
    undistorter = Undistorter(frame.camera, TYPICAL_DISTORTION)
    slots = FrameSlots(create_shared_memory("benchmark", SLOT_COUNT * SLOT_BYTES))
    colors, depths = (cycle(images) for images in zip(*raw_images, strict=True))
    slot = cycle(range(SLOT_COUNT))
    color_bgr, depth_mm = new_images(frame.camera.width, frame.camera.height)
    slots.write(0, 0, frame)
    return {
        "color: Bayer mosaic to BGR": lambda: conversion.to_bgr(next(colors), color_bgr),
        "depth: unpack, register, filter": lambda: conversion.to_mm(next(depths), depth_mm),
        "undistort color (camera file)": lambda: undistorter.undistort_color(frame.color_bgr),
        "undistort depth (camera file)": lambda: undistorter.undistort_depth(frame.depth_raw),
        "make the frame": lambda: replace(frame),
        "copy into shared memory": lambda: slots.write(next(slot), 0, frame),
        "service: out of shared memory": lambda: slots.read(0),
    }


def measure_steps(args: argparse.Namespace) -> None:
    """CPU time per frame of each step of the driver, on raw frames in a tight loop.

    `kinect cost` measures the whole driver: it also contains libfreenect and the simulated bus.
    """
    limit_freed_memory()  # as `run` does
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = write_fitted_usb_frames(folder, folder_frames(args.folder, None, args.frames))
        with simulated_kinect(folder, frames, registers=True) as kinect:
            kinect.activate()
            with make_kinect_without_motor() as camera:
                frame, conversion = camera.read(5.0), camera._conversion
            steps = make_steps(frame, conversion, read_raw_images(frames))
            ms: dict[str, list[float]] = {step: [] for step in steps}
            for _ in range(args.rounds):
                for step, run in steps.items():
                    ms[step].append(_mean_ms(run, args.frames))
    print(STEPS_TABLE.head)
    for step, measured in ms.items():
        print(STEPS_TABLE.row(step, median(measured)))


def _mean_ms(run: Callable[[], object], count: int) -> float:
    def run_all() -> None:
        for _ in range(count):
            run()

    return measure_cpu_ms(run_all)[1] / count


def measure_processes(args: argparse.Namespace) -> None:
    """CPU time and memory of each process of `kinect-vo run` with its defaults.

    PSS is the proportional set size: a page of several processes counts in parts, so that the sum
    is the memory of all.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = write_fitted_usb_frames(folder, folder_frames(args.folder, None, args.frames))
        with (
            simulated_kinect(folder, frames, registers=False) as kinect,
            running_service(folder, kinect.environment, popen=subprocess.Popen) as service,
        ):
            service.wait_until_streaming(time.monotonic())
            time.sleep(WARM_UP_S)
            _print_processes(service.process.pid, kinect, args.seconds)
            service.stop()


def _print_processes(service: int, kinect: KinectSimulator, seconds: float) -> None:
    processes = {service: "service"} | {each: _name_of(each) for each in descendants_of(service)}
    before, sent, begin_s = (
        measure_processor_use(*processes),
        min(kinect.frames_sent),
        time.monotonic(),
    )
    time.sleep(seconds)
    used = measure_processor_use(*processes).since(before).by_process
    duration_s, count = time.monotonic() - begin_s, min(kinect.frames_sent) - sent
    rows = {
        name: (
            1e3 * used[process] / count,
            100.0 * used[process] / duration_s,
            *(kb / 1e3 for kb in proportional_memory_kb(process)),
        )
        for process, name in processes.items()
    }
    print(PROCESSES_TABLE.head)
    for name, cells in rows.items():
        print(PROCESSES_TABLE.row(name, *cells))
    print(PROCESSES_TABLE.row("all", *map(sum, zip(*rows.values(), strict=True))))


def _name_of(process: int) -> str:
    """Name of a worker by its function: "recorder" for ...recorder.worker:run_recorder."""
    function = next(word for word in command_line_of(process) if ":run" in word)
    package = function.partition(":")[0].removesuffix(".worker").rpartition(".")[2]
    return {"subprocess_camera": "driver"}.get(package, package.removesuffix("_process"))


VARIANTS: Variants = {
    "steps": (
        (
            FOLDER,
            option("--frames", type=int, default=60, help="number of frames"),
            option("--rounds", type=int, default=9, help="repetitions; the median counts"),
        ),
        measure_steps,
    ),
    "processes": (
        (
            FOLDER,
            option("--frames", type=int, help="use only the first N frames"),
            option("--seconds", type=float, default=30.0, help="duration after the warm-up"),
        ),
        measure_processes,
    ),
}
