"""Checks whether the sensor is on the USB, is supported, and has enough bandwidth."""

from drivers.camera import is_serial
from drivers.core.errors import UserFacingError
from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.sysfs import KernelUsbDevice
from vo_service.tools.doctor.usb_probe import UsbSensor

MIN_SPEED_MBIT_S = 480.0
HIGH_BANDWIDTH_CLASSES = {"01": "audio", "0e": "video"}
OWN_CONTROLLER_FIX = "plug one of them into a port of another USB controller: `lsusb -t` shows them"


class SensorPresenceCheck:
    """Check that the requested sensor is connected; name other sensors if it is not."""

    name = "sensor"
    needs = ("libraries",)

    def run(self, context: CheckContext) -> Finding:
        try:
            sensors = context.sensors
        except UserFacingError as error:
            return failed(
                f"the USB cannot be listed: {error}", "unplug the sensor and plug it in again"
            )
        matching = [sensor for sensor in sensors if context.requested.matches(sensor)]
        others = [sensor for sensor in sensors if not context.requested.matches(sensor)]
        facts = {"sensors": [f"{sensor.model} {sensor.where}" for sensor in sensors]}
        if not matching:
            return _missing_sensor_finding(context, others, facts)
        return passed(
            _describe_sensor(matching[0]),
            model=matching[0].model,
            serial=matching[0].serial,
            **facts,
        )


def _describe_sensor(sensor: UsbSensor) -> str:
    serial = f", serial {sensor.serial}" if is_serial(sensor.serial) else ""
    return f"{sensor.model}, {sensor.where}{serial}"


def _missing_sensor_finding(
    context: CheckContext, others: list[UsbSensor], facts: dict[str, list[str]]
) -> Finding:
    """Return the finding for a missing sensor, which names the sensors that are connected."""
    models = " or ".join(sorted(context.requested.models))
    unsupported = [sensor for sensor in others if not sensor.is_supported]
    if unsupported:
        return failed(
            f"{_describe_sensor(unsupported[0])}: unsupported model (different hardware)",
            f"use a {models}",
            **facts,
        )
    if others and context.requested.serial:
        return failed(
            f"no sensor has the serial {context.requested.serial}; "
            f"connected: {_describe_sensor(others[0])}",
            "`kinect-vo devices` lists the values for --camera",
            **facts,
        )
    if others:
        return failed(
            f"{_describe_sensor(others[0])} is another kind of camera",
            "`kinect-vo devices` lists the values for --camera",
            **facts,
        )
    return failed("no sensor on the USB", context.requested.connect_fix, **facts)


class UsbSpeedCheck:
    """Check that the USB link is fast enough for the sensor's 35 MB/s."""

    name = "usb-speed"
    needs = ("sensor",)

    def run(self, context: CheckContext) -> Finding:
        speed_mbit_s = context.sensor.speed_mbit_s or _kernel_speed_mbit_s(context)
        if speed_mbit_s is None:
            return unknown("not known: this system does not report it")
        text = f"{speed_mbit_s:g} Mbit/s"
        if speed_mbit_s < MIN_SPEED_MBIT_S:
            return failed(
                f"{text}; the sensor needs {MIN_SPEED_MBIT_S:g}",
                "use another port and cable, without an old hub",
                speed_mbit_s=speed_mbit_s,
            )
        return passed(text, speed_mbit_s=speed_mbit_s)


def _kernel_speed_mbit_s(context: CheckContext) -> float | None:
    device = context.kernel_device(context.sensor.camera)
    try:
        return float(device.attribute("speed")) if device else None
    except ValueError:
        return None


class ControllerCheck:
    """Warn if another device needs the controller's bandwidth; a Kinect reserves over half."""

    name = "controller"
    needs = ("sensor",)

    def run(self, context: CheckContext) -> Finding:
        own = context.kernel_device(context.sensor.camera)
        if own is None or not own.controller:
            return unknown("not known: this system does not report it")
        sharing = _devices_sharing_controller(context, own)
        facts = {"controller": own.controller, "sharing": [device.name for device in sharing]}
        competing = [device for device in sharing if _needs_bandwidth(context, device)]
        if competing:
            names = ", ".join(device.name for device in competing)
            return warned(
                f"{own.controller} also serves {names}, which may need its bandwidth too",
                OWN_CONTROLLER_FIX,
                **facts,
            )
        served = ", ".join(device.name for device in sharing) or "the sensor alone"
        return passed(f"{own.controller} serves {served}", **facts)


def _devices_sharing_controller(
    context: CheckContext, own: KernelUsbDevice
) -> list[KernelUsbDevice]:
    """Return the other devices on the sensor's controller, without hubs and the sensor's parts."""
    parts = (context.sensor.camera, *context.sensor.others)
    own_addresses = {(str(part.bus), str(part.address)) for part in parts}
    return [
        device
        for device in context.kernel_devices
        if device.controller == own.controller
        and not device.is_hub
        and device.bus_and_address not in own_addresses
    ]


def _needs_bandwidth(context: CheckContext, device: KernelUsbDevice) -> bool:
    """Return True for audio and video devices and for another sensor."""
    cameras = {
        (str(other.camera.bus), str(other.camera.address))
        for other in context.sensors
        if other is not context.sensor
    }
    return (
        bool(device.interface_classes & HIGH_BANDWIDTH_CLASSES.keys())
        or device.bus_and_address in cameras
    )
