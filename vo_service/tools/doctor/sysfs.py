"""USB devices as the kernel lists them in ``/sys/bus/usb/devices``, or in a folder like it."""

import re
from dataclasses import dataclass
from pathlib import Path

HUB_CLASS = "09"
_ROOT_HUB = re.compile(r"usb\d+")


@dataclass(frozen=True)
class KernelUsbDevice:
    """One USB device; `path` has no symbolic links."""

    path: Path

    def attribute(self, name: str) -> str:
        """Return the text of an attribute, or "" if it does not exist."""
        try:
            return (self.path / name).read_text().strip()
        except OSError:
            return ""

    @property
    def bus_and_address(self) -> tuple[str, str]:
        """Bus and address as texts."""
        return self.attribute("busnum"), self.attribute("devnum")

    @property
    def controller(self) -> str:
        """Name of the host controller, such as 0000:00:14.0; "" if not known."""
        roots = [folder for folder in self.path.parents if _ROOT_HUB.fullmatch(folder.name)]
        return roots[0].parent.name if roots else ""

    @property
    def name(self) -> str:
        """Manufacturer, product and ids."""
        words = [self.attribute("manufacturer"), self.attribute("product")]
        ids = f"{self.attribute('idVendor')}:{self.attribute('idProduct')}"
        return " ".join(word for word in [*words, ids] if word)

    @property
    def is_hub(self) -> bool:
        """True for a hub, including the controller's root hub."""
        return self.attribute("bDeviceClass") == HUB_CLASS

    @property
    def interfaces(self) -> list[Path]:
        """Folders of its interfaces."""
        return sorted(self.path.glob(f"{self.path.name}:*"))

    @property
    def interface_classes(self) -> set[str]:
        """Interface classes, two hexadecimal digits: 01 audio, 03 input, 08 storage, 0e video."""
        return {_read_text(folder / "bInterfaceClass") for folder in self.interfaces}

    @property
    def drivers(self) -> list[str]:
        """Kernel drivers of its interfaces; "usbfs" means that a program has claimed one."""
        links = [folder / "driver" for folder in self.interfaces]
        return sorted({link.resolve().name for link in links if link.is_symlink()})

    @property
    def video_nodes(self) -> list[str]:
        """Names of its webcam devices in /dev."""
        return sorted(path.name for path in self.path.glob("*/video4linux/video*"))


def list_usb_devices(sys: Path) -> list[KernelUsbDevice]:
    """List all devices and hubs; empty if the kernel lists no USB."""
    try:
        links = sorted((sys / "bus/usb/devices").iterdir())
    except OSError:
        return []
    return [KernelUsbDevice(link.resolve()) for link in links if (link / "idVendor").exists()]


def _read_text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
