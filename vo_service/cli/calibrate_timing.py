"""``kinect-vo calibrate --timing``: measure readout and depth offset from fast motion."""

import argparse
import json
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from drivers.calibration import CAMERA_FILE_NAME, find_calibration
from drivers.core.errors import InputError
from vo_service.cli.kernels import run_warm_up
from vo_service.config import Config, read_config
from vo_service.odometry.registry import warm_up
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.calibration.motion_segments import (
    SEGMENT_FRAMES,
    CollectedSegments,
    collect_segments_from_folder,
    collect_segments_live,
)
from vo_service.tools.calibration.output_files import check_writable
from vo_service.tools.calibration.timing import TimingEstimate, estimate_timing
from vo_service.tools.calibration.timing_cost import SensorTiming
from vo_service.tools.calibration.timing_file import read_timing, save_timing

# Options that are valid only with a board.
BOARD_ONLY_OPTIONS = ("square", "marker", "depth", "keep", "rerun", "picture", "print_board")


def calibrate_timing(args: argparse.Namespace) -> int:
    """Measure the timing and save it.

    Raises:
        UserFacingError: If an option or the recording is not valid, or if the file cannot be
            written.
    """
    if (args.folder is None) == (args.camera is None):
        raise InputError("name a FOLDER that was recorded, or a camera to shake: --camera")
    config = read_config(args.config)
    output = _choose_output(args, config)
    _check_arguments(args, output)
    terminal = Terminal()
    collected = _collect_segments(args, config, terminal)
    before = read_timing(output, collected.camera)
    measured = estimate_timing(collected.segments, terminal.show)
    terminal.clear()
    heading = (
        f"kinect-vo calibrate --timing, {date.today()}: {measured.segment_count} pieces of "
        f"{SEGMENT_FRAMES} frames"
    )
    kept = save_timing(output, collected.camera, measured.timing, heading)
    files = {"camera_file": str(output), "kept": None if kept is None else str(kept)}
    if args.json:
        print(json.dumps(files | _as_json(before, measured, collected)))
        return 0
    print(_as_table(before, measured, collected))
    backup = f"; the one before is {kept.name}" if kept else ""
    print(f"\nsaved in {output}{backup}")
    return 0


def _choose_output(args: argparse.Namespace, config: Config) -> Path:
    """Choose the camera file to change."""
    named: Path | None = args.output or args.camera_file or config.camera.file
    if named is not None:
        return named
    if args.folder is not None:
        return Path(args.folder / CAMERA_FILE_NAME)
    raise InputError(
        "--timing puts its result into a camera file: name it with --camera-file, or make one "
        "first, from views of a board"
    )


def _check_arguments(args: argparse.Namespace, output: Path) -> None:
    """Check before the work, not after it."""
    given = [name for name in BOARD_ONLY_OPTIONS if getattr(args, name)]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is about a board, which --timing does without; leave one out")
    check_writable(output)
    if args.folder is not None:
        _check_recording(args.folder, args.camera_file, output)


def _check_recording(folder: Path, file: Path | None, output: Path) -> None:
    read = find_calibration(folder, file)
    is_read = output.resolve() == (file or folder / CAMERA_FILE_NAME).resolve()
    offset_s = read_timing(output, read).depth_offset_s
    if offset_s != 0.0 and not is_read:
        raise InputError(
            f"{output}: depth_offset_s = {offset_s:g} may be in the stamps of {folder} already; "
            "measure with the camera, or set it to 0 and record again"
        )


def _collect_segments(
    args: argparse.Namespace, config: Config, terminal: Terminal
) -> CollectedSegments:
    with stop_on_signals() as stop:
        run_warm_up(partial(warm_up, "direct"), terminal, stop)
        if args.folder is not None:
            collected = collect_segments_from_folder(
                args.folder, args.camera_file, terminal, stop.event
            )
            stop.check()
        else:
            file = args.camera_file or config.camera.file or args.output
            collected = collect_segments_live(
                args.camera, file, config.sensor, terminal, stop.event
            )
    terminal.clear()
    return collected


def _as_table(before: SensorTiming, measured: TimingEstimate, collected: CollectedSegments) -> str:
    now, sigma = measured.timing, measured.sigma
    rows = [
        f"the {measured.segment_count} fastest segments of {SEGMENT_FRAMES} frames, "
        f"of {collected.frame_count} frames",
        "",
        f"{'':<20}{'before':>12}{'now':>20}",
        _format_row("readout_s", before.readout_s, now.readout_s, sigma.readout_s),
        _format_row(
            "depth_offset_s", before.depth_offset_s, now.depth_offset_s, sigma.depth_offset_s
        ),
    ]
    return "\n".join(rows)


def _format_row(key: str, before_s: float, now_s: float, sigma_s: float) -> str:
    now = f"{1e3 * now_s:.1f} ± {1e3 * sigma_s:.1f} ms"
    return f"{key:<20}{f'{1e3 * before_s:.1f} ms':>12}{now:>20}"


def _as_json(
    before: SensorTiming, measured: TimingEstimate, collected: CollectedSegments
) -> dict[str, Any]:
    now, sigma = measured.timing, measured.sigma
    return {
        "frames": collected.frame_count,
        "pieces": measured.segment_count,
        "readout_s": {"before": before.readout_s, "now": now.readout_s, "sigma": sigma.readout_s},
        "depth_offset_s": {
            "before": before.depth_offset_s,
            "now": now.depth_offset_s,
            "sigma": sigma.depth_offset_s,
        },
    }
