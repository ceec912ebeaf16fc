"""Each mechanism exists once: this searches the product's source for second ones."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# A call or a base class by the last part of its name, and the files that may have it, with the
# reason for each beside the mechanism's own file.
SINGLE = {
    "Popen": {
        "drivers/core/process/worker_process.py",
        "vo_service/outputs/rerun/web_viewer_server.py",  # Rerun's own program, for a moment
    },
    "Process": {
        "vo_service/slam/mapper/mesh_job.py",  # a fork that shares the memory of the keyframes
    },
    "ProcessPoolExecutor": set(),
    "fork": set(),
    "memfd_create": {"drivers/core/process/record_ring.py"},
    "SharedMemory": set(),
    "Condition": {
        "drivers/core/queues.py",
        "drivers/playback/frame_buffer.py",  # frames with a due time
        "vo_service/client/frame_client.py",  # the newest frame, made of several messages
        "vo_service/client/subscription.py",  # the newest pose, which is not taken
    },
    "Queue": set(),
    "BackgroundConnection": {
        "vo_service/cli/listen.py",  # prints messages as they come
        "vo_service/client/subscription.py",  # base of both clients
    },
    "imencode": {"drivers/recording/image_encoding.py"},
    "imwrite": set(),
    # Which frame of a playback is due.
    "bisect_right": {"drivers/pacing.py"},
    "disk_usage": {"drivers/core/write_errors.py"},
    "ThreadPoolExecutor": {
        "drivers/recording/frame_recorder.py",
        "drivers/synthetic/render_worker.py",  # threads that render
        "drivers/synthetic/texture_atlas.py",  # threads that paint
    },
    "setitimer": {"drivers/core/process/service_connection.py"},
    # The motion that most matched points agree with; the wrapper and a rival of that motion.
    "find_consensus": {"vo_service/odometry/features/verification.py"},
    "TokenBucket": {  # users of the one rate limiter
        "vo_service/outputs/zenoh/receiver.py",
        "vo_service/outputs/zenoh/session_endpoints.py",
    },
}


def product_files() -> Iterator[Path]:
    """Yield the product's source files."""
    for package in ("drivers", "vo_service"):
        yield from (ROOT / package).rglob("*.py")


def called_names(tree: ast.AST) -> Iterator[str]:
    """Yield the last part of the name of each call."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            function = node.func
            if isinstance(function, ast.Attribute):
                yield function.attr
            elif isinstance(function, ast.Name):
                yield function.id


@pytest.fixture(scope="module")
def callers() -> dict[str, set[str]]:
    """The files that call each name."""
    found: dict[str, set[str]] = {}
    for file in product_files():
        for name in called_names(ast.parse(file.read_text())):
            found.setdefault(name, set()).add(str(file.relative_to(ROOT)))
    return found


@pytest.mark.parametrize("name", SINGLE)
def test_a_mechanism_is_in_one_place(callers: dict[str, set[str]], name: str) -> None:
    assert callers.get(name, set()) == SINGLE[name]


def test_what_sleeps_until_a_frame_is_due_is_one_place() -> None:
    """A sleep is passed to the clock of a pacer; each other one waits for a device."""
    sleepers = {
        str(file.relative_to(ROOT))
        for file in (ROOT / "drivers").rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "time.sleep"
    }
    assert sleepers == {
        "drivers/pacing.py",
        "drivers/camera.py",  # before a lost camera is opened again
        "drivers/freenect/camera.py",  # the same
        "drivers/kinect_usb/usb_devices.py",  # the same
        "drivers/openni2/device.py",  # a sensor that settles
    }


def test_numbered_files_are_named_in_one_place() -> None:
    """FILE-0001: a number of four digits in a formatted string."""
    namers = {
        str(file.relative_to(ROOT))
        for file in product_files()
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.FormattedValue)
        and node.format_spec is not None
        and ast.unparse(node.format_spec) == "f'04d'"
    }
    assert namers == {"drivers/core/files.py"}


def test_every_frame_is_recorded_by_one_recorder() -> None:
    """Only a recorder asks whether stamps rise and the camera stays the same, see `FrameStamps`."""
    askers = {
        str(file.relative_to(ROOT))
        for file in product_files()
        if "is_after" in called_names(ast.parse(file.read_text()))
    }
    assert askers == {"drivers/recording/frame_recorder.py"}


def test_only_the_file_helpers_make_temporary_names() -> None:
    """A name with a dot before and .part behind is that of an atomic write."""
    makers = {
        str(file.relative_to(ROOT))
        for file in product_files()
        if ('f".{' in file.read_text() and "PARTIAL_SUFFIX" in file.read_text())
        or '.part")' in file.read_text()
    }
    assert makers == {
        "drivers/core/files.py",
        "drivers/core/folders.py",  # a folder of kernels that is copied
        "vo_service/tools/download/sequence_download.py",  # kept after an error, to be resumed
    }
