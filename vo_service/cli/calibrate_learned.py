"""``kinect-vo calibrate --save-learned``: what a service has learned, in its camera file."""

import json
import logging
from datetime import date

from drivers.calibration import read_calibration
from drivers.core import InputError
from vo_service.cli.calibrate_request import CalibrationRequest
from vo_service.config import read_config
from vo_service.sensor_memory import (
    SAME_FOCAL_PX,
    RememberedSensor,
    find_remembered_sensors,
    memory_folders,
)
from vo_service.tools.calibration.saved_timing import SavedTiming
from vo_service.tools.calibration.timing import (
    read_camera,
    remembered_as_timing,
    save_timing,
    told_timing,
)

logger = logging.getLogger(__name__)


def save_learned(request: CalibrationRequest) -> int:
    """Write the learned timing and focal length of a sensor into a camera file.

    Raises:
        InputError: If nothing has been learned, if it is unclear of which sensor, or if an option
            or the camera file is not valid.
        UserFacingError: If the file cannot be written.
    """
    if request.timing or request.folder is not None or request.camera is not None:
        raise InputError(
            "--save-learned takes what a service has learned, without a camera; leave out FOLDER, "
            "--camera and --timing"
        )
    config = read_config(request.config)
    output = request.file_to_change(config, "--save-learned")
    fallback = read_calibration(request.camera_file or config.camera.file or output)
    learned = _choose_sensor(request.serial)
    camera = read_camera(output, fallback)
    values = {"before": told_timing(camera), "now": remembered_as_timing(learned)}
    source: dict[str, object] = {"serial": learned.serial}
    focal = learned.focal_length
    prior = None if focal is None else focal.prior_for(camera.fx)
    scale = 1.0 if prior is None else prior.scale
    if scale != 1.0:
        source["factor on fx and fy"] = round(scale, 5)
    heading = f"kinect-vo calibrate --save-learned, {date.today()}: sensor {learned.serial}"
    backup = save_timing(output, fallback, values["now"], heading, scale)
    saved = SavedTiming(source, values, output, backup)
    print(json.dumps(saved.as_json()) if request.json else saved.as_table())
    if focal is not None and abs(focal.fx - camera.fx) > SAME_FOCAL_PX:
        logger.warning(
            "fx and fy are unchanged: the focal length was learned with fx = %.2f, but %s has %.2f",
            focal.fx,
            output,
            camera.fx,
        )
    return 0


def _choose_sensor(serial: str | None) -> RememberedSensor:
    """Return what was learned of a sensor, or of the only one.

    Raises:
        InputError: There is none, or there are several.
    """
    folders = memory_folders()
    remembered = find_remembered_sensors(folders)
    known = ", ".join(sorted(remembered))
    if not remembered:
        searched = ", ".join(map(str, folders)) or "no folder"
        raise InputError(
            f"no service has learned a timing yet (searched: {searched}); let kinect-vo run until "
            "camera.sensor_timing_source in its status is learned, and use sudo for a service of "
            "systemd"
        )
    if serial is not None and serial not in remembered:
        raise InputError(f"--serial {serial}: nothing is learned of it; known: {known}")
    if serial is None and len(remembered) > 1:
        raise InputError(f"several sensors are known; choose one with --serial: {known}")
    return remembered[serial if serial is not None else known]
