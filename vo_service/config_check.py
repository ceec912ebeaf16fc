"""Check of a configuration file, and of the files and addresses in it, without opening a camera."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from drivers.core.errors import InputError
from vo_service.config import CameraConfig, Config, read_config
from vo_service.config_tables import RecorderConfig, RerunConfig


def check_config(path: Path) -> list[str]:
    """Read a configuration file, and check the files and addresses in it.

    Relative paths start at the current folder, as for `run`.

    Returns:
        Warnings about settings that are allowed but dangerous.

    Raises:
        InputError: For the first mistake, with the file.
    """
    config = read_config(path)
    _check_camera(config.camera, path)
    _check_rerun(config.rerun, path)
    _check_recorder(config.recorder, path)
    return list(_check_zenoh(config))


def _check_camera(camera: CameraConfig, path: Path) -> None:
    kind, _, argument = camera.source.partition(":")
    if camera.file is not None and kind == "synthetic":
        raise InputError(
            f"{path}: key `camera.file`: the virtual Kinect has its own calibration; leave it out"
        )
    if camera.file is not None:
        from drivers.calibration import read_calibration

        read_calibration(camera.file)
    is_recording = kind in ("tum", "fakenect") or argument.endswith(".oni")
    if is_recording and not Path(argument).exists():
        raise InputError(f"{path}: key `camera.source`: no recording {argument}; give another path")


def _check_rerun(rerun: RerunConfig, path: Path) -> None:
    from vo_service.outputs.rerun.targets import check_targets

    try:
        check_targets(rerun.targets)
    except InputError as error:
        raise InputError(f"{path}: key `rerun.targets`: {error}") from error
    for target in rerun.targets:
        folder = Path(target).parent
        if target.endswith(".rrd") and not folder.is_dir():
            raise InputError(
                f"{path}: key `rerun.targets`: {target}: there is no folder {folder}; create it"
            )
    if rerun.targets and find_spec("rerun") is None:
        raise InputError(
            f"{path}: key `rerun.targets`: Rerun is not installed: pip install 'kinect-vo[rerun]'"
        )


def _check_recorder(recorder: RecorderConfig, path: Path) -> None:
    if not recorder.enabled or recorder.folder is None:
        return
    from drivers.core.files import check_writable

    reason = check_writable(recorder.folder)
    if reason:
        raise InputError(f"{path}: key `recorder.folder`: {reason}; name a writable folder")


def _check_zenoh(config: Config) -> Iterator[str]:
    from vo_service.outputs.zenoh.session_check import check_session_config

    warning = check_session_config(config.zenoh)
    if warning:
        yield warning
