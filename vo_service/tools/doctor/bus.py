"""Whether the sensor is on the USB, can be driven, and has enough of the bus."""

from drivers.core.errors import UserFacingError
from vo_service.tools.doctor.context import CheckContext
from vo_service.tools.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.tools.doctor.sysfs import KernelUsbDevice
from vo_service.tools.doctor.usb_probe import UsbSensor

MIN_SPEED_MBIT_S = 480.0
HIGH_BANDWIDTH_CLASSES = {"01": "audio", "0e": "video"}
OWN_CONTROLLER_FIX = "plug one of them into a port of another USB controller: `lsusb -t` shows them"


class SensorPresenceCheck:
    """Names the sensor, and those that are there in its place."""

    name = "sensor"
    needs = ("libraries",)

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        try:
            sensors = context.sensors
        except UserFacingError as error:
            return failed(f"the USB cannot be looked at: {error}", "plug the sensor out and in")
        here = [sensor for sensor in sensors if context.requested.matches(sensor)]
        others = [sensor for sensor in sensors if not context.requested.matches(sensor)]
        facts = {"sensors": [f"{sensor.model} {sensor.where}" for sensor in sensors]}
        if not here:
            return _missing_sensor_finding(context, others, facts)
        return passed(
            _describe_sensor(here[0]), model=here[0].model, serial=here[0].serial, **facts
        )


def _describe_sensor(sensor: UsbSensor) -> str:
    serial = f", serial {sensor.serial}" if sensor.serial.strip("0") else ""
    return f"{sensor.model}, {sensor.where}{serial}"


def _missing_sensor_finding(
    context: CheckContext, others: list[UsbSensor], facts: dict[str, list[str]]
) -> Finding:
    """Say what is there in place of the sensor."""
    models = " or ".join(sorted(context.requested.models))
    unsupported = [sensor for sensor in others if not sensor.is_supported]
    if unsupported:
        return failed(
            f"{_describe_sensor(unsupported[0])}: this model is not supported, its electronics are others",
            f"use a {models}",
            **facts,
        )
    if others and context.requested.serial:
        return failed(
            f"none has the serial {context.requested.serial}; there is {_describe_sensor(others[0])}",
            "`kinect-vo devices` lists what --camera may name",
            **facts,
        )
    if others:
        return failed(
            f"{_describe_sensor(others[0])}, which is another kind of camera",
            "`kinect-vo devices` lists what --camera may name",
            **facts,
        )
    return failed("no sensor on the USB", context.requested.connect_fix, **facts)


class UsbSpeedCheck:
    """A sensor that has to send 35 MB/s is not on a cable for keyboards."""

    name = "usb-speed"
    needs = ("sensor",)

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        speed_mbit_s = context.sensor.speed_mbit_s or _kernel_speed_mbit_s(context)
        if speed_mbit_s is None:
            return unknown("not known: this system does not tell")
        text = f"{speed_mbit_s:g} Mbit/s"
        if speed_mbit_s < MIN_SPEED_MBIT_S:
            return failed(
                f"{text}; the sensor needs {MIN_SPEED_MBIT_S:g}",
                "use another port and cable, without an old hub between",
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
    """A Kinect reserves more than half of what a controller can promise."""

    name = "controller"
    needs = ("sensor",)

    def run(self, context: CheckContext) -> Finding:
        """See `Check`."""
        own = context.kernel_device(context.sensor.camera)
        if own is None or not own.controller:
            return unknown("not known: this system does not tell")
        sharing = _devices_sharing_controller(context, own)
        facts = {"controller": own.controller, "sharing": [device.name for device in sharing]}
        greedy = [device for device in sharing if _needs_bandwidth(context, device)]
        if greedy:
            names = ", ".join(device.name for device in greedy)
            return warned(
                f"{own.controller} also serves {names}, which may need its bandwidth too",
                OWN_CONTROLLER_FIX,
                **facts,
            )
        with_it = ", ".join(device.name for device in sharing) or "the sensor alone"
        return passed(f"{own.controller} serves {with_it}", **facts)


def _devices_sharing_controller(
    context: CheckContext, own: KernelUsbDevice
) -> list[KernelUsbDevice]:
    """The other devices at the sensor's controller, without hubs and the sensor's own parts."""
    parts = (context.sensor.camera, *context.sensor.others)
    places = {(str(part.bus), str(part.address)) for part in parts}
    return [
        device
        for device in context.kernel_devices
        if device.controller == own.controller
        and not device.is_hub
        and device.bus_and_address not in places
    ]


def _needs_bandwidth(context: CheckContext, device: KernelUsbDevice) -> bool:
    """True for what plays or films, and for another sensor."""
    cameras = {
        (str(other.camera.bus), str(other.camera.address))
        for other in context.sensors
        if other is not context.sensor
    }
    return (
        bool(device.interface_classes & HIGH_BANDWIDTH_CLASSES.keys())
        or device.bus_and_address in cameras
    )
