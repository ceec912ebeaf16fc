"""The kernel's view of the USB: ``/sys/bus/usb/devices``, or a folder laid out like it."""

import re
from dataclasses import dataclass
from pathlib import Path

HUB_CLASS = "09"
_ROOT_HUB = re.compile(r"usb\d+")


@dataclass(frozen=True)
class KernelUsbDevice:
    """One device; `path` has no symbolic link in it."""

    path: Path

    def attribute(self, name: str) -> str:
        """The text of an attribute; "" if it has none."""
        try:
            return (self.path / name).read_text().strip()
        except OSError:
            return ""

    @property
    def bus_and_address(self) -> tuple[str, str]:
        """Bus and address, as the attributes hold them."""
        return self.attribute("busnum"), self.attribute("devnum")

    @property
    def controller(self) -> str:
        """Name of the host controller, such as 0000:00:14.0; "" where the path does not tell."""
        roots = [folder for folder in self.path.parents if _ROOT_HUB.fullmatch(folder.name)]
        return roots[0].parent.name if roots else ""

    @property
    def name(self) -> str:
        """What it calls itself, and its ids."""
        words = [self.attribute("manufacturer"), self.attribute("product")]
        ids = f"{self.attribute('idVendor')}:{self.attribute('idProduct')}"
        return " ".join(word for word in [*words, ids] if word)

    @property
    def is_hub(self) -> bool:
        """True for a hub, also for the one inside the controller."""
        return self.attribute("bDeviceClass") == HUB_CLASS

    @property
    def interfaces(self) -> list[Path]:
        """Its interfaces' folders."""
        return sorted(self.path.glob(f"{self.path.name}:*"))

    @property
    def interface_classes(self) -> set[str]:
        """Two hexadecimal digits each: 01 audio, 03 input, 08 storage, 0e video."""
        return {_read_text(folder / "bInterfaceClass") for folder in self.interfaces}

    @property
    def drivers(self) -> list[str]:
        """Kernel drivers of its interfaces; "usbfs" is a program that has claimed one."""
        links = [folder / "driver" for folder in self.interfaces]
        return sorted({link.resolve().name for link in links if link.is_symlink()})

    @property
    def video_nodes(self) -> list[str]:
        """Names in /dev that a webcam driver gave it."""
        return sorted(path.name for path in self.path.glob("*/video4linux/video*"))


def list_usb_devices(sys: Path) -> list[KernelUsbDevice]:
    """Every device, hubs too; none where the kernel has no USB or does not show it."""
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
