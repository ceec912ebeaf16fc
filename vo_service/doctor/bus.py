"""Whether the sensor is on the USB, can be driven, and has enough of the bus."""

from drivers.errors import UserFacingError
from vo_service.doctor.context import Context
from vo_service.doctor.finding import Finding, failed, passed, unknown, warned
from vo_service.doctor.sysfs import KernelUsbDevice
from vo_service.doctor.usb_facts import UsbSensor

HIGH_SPEED_MBIT_S = 480.0
GREEDY_CLASSES = {"01": "audio", "0e": "video"}
OWN_CONTROLLER = "plug one of them into a port of another USB controller: `lsusb -t` shows them"


class SensorOnBus:
    """Names the sensor, and those that are there in its place."""

    name = "sensor"
    needs = ("libraries",)

    def run(self, context: Context) -> Finding:
        """See `Check`."""
        try:
            sensors = context.sensors
        except UserFacingError as error:
            return failed(f"the USB cannot be looked at: {error}", "plug the sensor out and in")
        here = [sensor for sensor in sensors if context.wanted.is_it(sensor)]
        others = [sensor for sensor in sensors if not context.wanted.is_it(sensor)]
        facts = {"sensors": [f"{sensor.model} {sensor.where}" for sensor in sensors]}
        if not here:
            return _missing(context, others, facts)
        return passed(_told(here[0]), model=here[0].model, serial=here[0].serial, **facts)


def _told(sensor: UsbSensor) -> str:
    serial = f", serial {sensor.serial}" if sensor.serial.strip("0") else ""
    return f"{sensor.model}, {sensor.where}{serial}"


def _missing(context: Context, others: list[UsbSensor], facts: dict[str, list[str]]) -> Finding:
    """Say what is there in place of the sensor."""
    models = " or ".join(sorted(context.wanted.models))
    unsupported = [sensor for sensor in others if not sensor.is_supported]
    if unsupported:
        return failed(
            f"{_told(unsupported[0])}: this model is not supported, its electronics are others",
            f"use a {models}",
            **facts,
        )
    if others and context.wanted.serial:
        return failed(
            f"none has the serial {context.wanted.serial}; there is {_told(others[0])}",
            "`kinect-vo devices` lists what --camera may name",
            **facts,
        )
    if others:
        return failed(
            f"{_told(others[0])}, which is another kind of camera",
            "`kinect-vo devices` lists what --camera may name",
            **facts,
        )
    return failed("no sensor on the USB", context.wanted.how_to_plug, **facts)


class UsbSpeed:
    """A sensor that has to send 35 MB/s is not on a cable for keyboards."""

    name = "usb-speed"
    needs = ("sensor",)

    def run(self, context: Context) -> Finding:
        """See `Check`."""
        speed_mbit_s = context.sensor.speed_mbit_s or _kernels_speed(context)
        if speed_mbit_s is None:
            return unknown("not known: this system does not tell")
        text = f"{speed_mbit_s:g} Mbit/s"
        if speed_mbit_s < HIGH_SPEED_MBIT_S:
            return failed(
                f"{text}; the sensor needs {HIGH_SPEED_MBIT_S:g}",
                "use another port and cable, without an old hub between",
                speed_mbit_s=speed_mbit_s,
            )
        return passed(text, speed_mbit_s=speed_mbit_s)


def _kernels_speed(context: Context) -> float | None:
    device = context.kernel_device(context.sensor.camera)
    try:
        return float(device.attribute("speed")) if device else None
    except ValueError:
        return None


class SharedController:
    """A Kinect reserves more than half of what a controller can promise."""

    name = "controller"
    needs = ("sensor",)

    def run(self, context: Context) -> Finding:
        """See `Check`."""
        own = context.kernel_device(context.sensor.camera)
        if own is None or not own.controller:
            return unknown("not known: this system does not tell")
        sharing = _sharing(context, own)
        facts = {"controller": own.controller, "sharing": [device.name for device in sharing]}
        greedy = [device for device in sharing if _needs_bandwidth(context, device)]
        if greedy:
            names = ", ".join(device.name for device in greedy)
            return warned(
                f"{own.controller} also serves {names}, which may need its bandwidth too",
                OWN_CONTROLLER,
                **facts,
            )
        with_it = ", ".join(device.name for device in sharing) or "the sensor alone"
        return passed(f"{own.controller} serves {with_it}", **facts)


def _sharing(context: Context, own: KernelUsbDevice) -> list[KernelUsbDevice]:
    """The other devices at the sensor's controller, without hubs and the sensor's own parts."""
    parts = (context.sensor.camera, *context.sensor.others)
    places = {(str(part.bus), str(part.address)) for part in parts}
    return [
        device
        for device in context.kernel_devices
        if device.controller == own.controller and not device.is_hub and device.place not in places
    ]


def _needs_bandwidth(context: Context, device: KernelUsbDevice) -> bool:
    """True for what plays or films, and for another sensor."""
    cameras = {
        (str(other.camera.bus), str(other.camera.address))
        for other in context.sensors
        if other is not context.sensor
    }
    return bool(device.interface_classes & GREEDY_CLASSES.keys()) or device.place in cameras
