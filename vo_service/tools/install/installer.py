"""Installation and removal of the service, with one line of output per step."""

import shutil
from collections.abc import Callable
from pathlib import Path

from drivers.core import UserFacingError
from vo_service.config import read_config
from vo_service.tools.install import udev
from vo_service.tools.install.program import PROGRAM_FOLDER, install_program, remove_program
from vo_service.tools.install.system_files import remove_file, write_file
from vo_service.tools.install.systemd import (
    COMMAND_LINK,
    CONFIG_FOLDER,
    DROP_IN,
    UNIT_FOLDER,
    OfflineSystemd,
    ServiceUnit,
    Systemd,
    link_command,
    list_unit_files,
    read_service_file,
    unlink_command,
)

PrintLine = Callable[[str], None]

# With DynamicUser, a folder is below `private`, and the usual path is a link to it.
DATA_FOLDERS = ("var/lib/private", "var/lib", "var/cache/private", "var/cache")


class Installer:
    """Installs into the file system below `root`, and removes it; can be run again at any time."""

    def __init__(
        self, root: Path, systemd: Systemd | OfflineSystemd, print_line: PrintLine
    ) -> None:
        """Set where to install; `print_line` is called with a line for each step."""
        self._root, self._systemd, self._print_line = root, systemd, print_line

    def install(self, unit: ServiceUnit, *, enable: bool, network_tls: bool) -> None:
        """Install everything for `unit`, and start it now and at boot if it is enabled.

        Args:
            network_tls: Whether to install the drop-in that opens the network with TLS.

        Raises:
            UserFacingError: A precondition fails, if possible before any change.
            OSError: A file cannot be written.
        """
        self._check_preconditions(unit)
        changed = self._install_program()
        for file in list_unit_files():
            changed |= self._write_file(file.path, file.text)
        if network_tls:
            changed |= self._write_file(unit.drop_in, read_service_file(DROP_IN))
        self._write_config(unit)
        self._report_written(COMMAND_LINK, link_command(self._root))
        for file in udev.list_system_files():
            changed |= self._write_file(file.path, file.text)
        if changed:
            self._systemd.reload_and_restart()
        if enable:
            self._systemd.enable(unit, self._print_line)
        else:
            self._print_line(f"start it with: systemctl enable --now {unit.unit_name}")

    def _check_preconditions(self, unit: ServiceUnit) -> None:
        """Raise UserFacingError if the service could not start."""
        config = self._root / unit.config
        if config.exists():
            read_config(config)
        groups = self._root / "etc/group"
        if groups.exists() and not any(
            line.startswith(f"{udev.GROUP}:") for line in groups.read_text().splitlines()
        ):
            raise UserFacingError(
                f"{groups}: the group {udev.GROUP} of the sensors does not exist; create it with: "
                f"groupadd --system {udev.GROUP}"
            )

    def _install_program(self) -> bool:
        folder = self._root / PROGRAM_FOLDER
        is_new = install_program(self._root, lambda step: self._print_line(f"{folder}: {step} ..."))
        return self._report_written(PROGRAM_FOLDER, is_new)

    def _write_file(self, path: Path, text: str) -> bool:
        return self._report_written(path, write_file(self._root / path, text))

    def _write_config(self, unit: ServiceUnit) -> None:
        """Write the default configuration unless the owner has one."""
        path = self._root / unit.config
        if path.exists():
            self._print_line(f"{path}: kept unchanged")
        else:
            self._write_file(unit.config, read_service_file("kinect.toml"))

    def _report_written(self, path: Path, is_new: bool) -> bool:
        self._print_line(f"{self._root / path}: {'written' if is_new else 'already installed'}")
        return is_new

    def uninstall(self, *, purge: bool) -> None:
        """Stop and remove the service; to purge is to delete the configuration and all data, too.

        Raises:
            UserFacingError: Systemd fails.
            OSError: A file cannot be removed.
        """
        self._systemd.disable_all()
        drop_ins = sorted((self._root / UNIT_FOLDER).glob(f"kinect-vo*.service.d/{DROP_IN}"))
        for path in [*(self._root / file.path for file in list_unit_files()), *drop_ins]:
            self._report_removed(path, remove_file(path))
        for folder in {path.parent for path in drop_ins}:
            if not any(folder.iterdir()):
                folder.rmdir()
        for file in udev.list_system_files():
            path = self._root / file.path
            self._report_removed(path, remove_file(path))
        self._report_removed(self._root / COMMAND_LINK, unlink_command(self._root))
        self._systemd.reload_after_removal()
        if purge:
            self._delete_data()
        elif (self._root / CONFIG_FOLDER).exists():
            self._print_line(
                f"{self._root / CONFIG_FOLDER}: kept, as the data in /var; see --purge"
            )
        self._report_removed(self._root / PROGRAM_FOLDER, remove_program(self._root))

    def _delete_data(self) -> None:
        data_folders = [
            path
            for folder in DATA_FOLDERS
            for pattern in ("kinect-vo", "kinect-vo-*")
            for path in sorted((self._root / folder).glob(pattern))
        ]
        for path in [self._root / CONFIG_FOLDER, *data_folders]:
            if path.is_symlink():
                path.unlink()
            elif path.is_dir():
                shutil.rmtree(path)
            else:
                continue
            self._report_removed(path, True)

    def _report_removed(self, path: Path, is_removed: bool) -> None:
        self._print_line(f"{path}: {'removed' if is_removed else 'not installed'}")
