"""The computer that boots, as the checks see it."""

import json
from dataclasses import dataclass
from pathlib import Path

from benchmarks.boot_container import Container
from benchmarks.boot_listener import BootListener

UNIT = "kinect-vo.service"
RECOVERY_TIMEOUT_S = 120.0
# A new version renders its room anew.
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
    """The container, its file system, the command as it lies in the checkout, and who listens."""

    container: Container
    tree: Path
    command: str
    listener: BootListener
    port: int

    def unit_property(self, name: str) -> str:
        """What systemd says of the service."""
        return self.container.run("systemctl", "show", UNIT, "-p", name, "--value").strip()

    def set_cpu_quota(self, text: str) -> None:
        """How much of a processor the service gets from now on."""
        self.container.run("systemctl", "set-property", "--runtime", UNIT, f"CPUQuota={text}")

    def write_config(self, level: str = "info") -> None:
        """A configuration that is right, unless `level` is none."""
        folder = self.tree / "etc" / "kinect-vo"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "kinect.toml").write_text(self.config_text(level))

    def config_text(self, level: str = "info") -> str:
        """The synthetic camera on the port that is listened to."""
        return CONFIG.format(port=self.port, level=level)

    def journal_entries(self, unit: str = UNIT) -> list[dict[str, str]]:
        """The journal of the service."""
        lines = self.container.run("journalctl", "-u", unit, "-o", "json", "--no-pager")
        return [json.loads(line) for line in lines.splitlines() if line.startswith("{")]
