"""The booted computer as the checks use it."""

import json
from dataclasses import dataclass
from pathlib import Path

from benchmarks.boot_container import Container
from benchmarks.boot_listener import BootListener

UNIT = "kinect-vo.service"
RECOVERY_TIMEOUT_S = 120.0
# A new version renders its room again.
RENDER_TIMEOUT_S = 900.0
CONFIG = """\
schema = 1
[camera]
source = "synthetic"
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
[log]
level = "{level}"
"""


@dataclass(frozen=True)
class BootedComputer:
    """A container with the service.

    Attributes:
        container: The running container.
        tree: Its file system.
        command: The `kinect-vo` of the checkout.
        listener: A subscriber outside the container.
        port: Port of the service.
    """

    container: Container
    tree: Path
    command: str
    listener: BootListener
    port: int

    def unit_property(self, name: str) -> str:
        """Read a property of the service from systemd."""
        return self.container.run("systemctl", "show", UNIT, "-p", name, "--value").strip()

    def set_cpu_quota(self, text: str) -> None:
        """Set the processor quota of the service; "" removes it."""
        self.container.run("systemctl", "set-property", "--runtime", UNIT, f"CPUQuota={text}")

    def write_config(self, level: str = "info") -> None:
        """Write the configuration; it is valid if `level` is a log level."""
        folder = self.tree / "etc" / "kinect-vo"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "kinect.toml").write_text(self.config_text(level))

    def config_text(self, level: str = "info") -> str:
        """Configuration of the synthetic camera on the listener's port."""
        return CONFIG.format(port=self.port, level=level)

    def journal_entries(self, unit: str = UNIT) -> list[dict[str, str]]:
        """Read the journal of a unit."""
        lines = self.container.run("journalctl", "-u", unit, "-o", "json", "--no-pager")
        return [json.loads(line) for line in lines.splitlines() if line.startswith("{")]
