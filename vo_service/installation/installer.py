"""Installing the service and taking it away, each step told in a line."""

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

from drivers.errors import UserFacingError
from vo_service import udev
from vo_service.config import read_config
from vo_service.installation.program import FOLDER, install_program, remove_program
from vo_service.installation.system_files import remove_file, write_file
from vo_service.installation.systemd import Offline, Systemd
from vo_service.installation.unit import (
    COMMAND,
    CONFIG_FOLDER,
    DROP_IN,
    UNIT_FOLDER,
    Unit,
    link_command,
    text_of,
    unit_files,
    unlink_command,
)

Tell = Callable[[str], None]

# With DynamicUser a folder lies below `private`, and a link to it where one would look.
KEPT = ("var/lib/private", "var/lib", "var/cache/private", "var/cache")


class Installer:
    """Installs into the file system below `root`; may be used again at any time."""

    def __init__(self, root: Path, systemd: Systemd | Offline, tell: Tell) -> None:
        self._root, self._systemd, self._tell = root, systemd, tell

    def install(self, unit: Unit, *, enable: bool, network_tls: bool) -> None:
        """Install everything for `unit`, and start it if asked to.

        Raises UserFacingError, before anything is changed where that can be known; OSError.
        """
        self._check(unit)
        changed = self._program()
        for file in unit_files():
            changed |= self._file(file.path, file.text)
        if network_tls:
            changed |= self._file(unit.drop_in, text_of(DROP_IN))
        self._config(unit)
        self._told(COMMAND, link_command(self._root))
        for file in udev.system_files():
            changed |= self._file(file.path, file.text)
        if changed:
            self._systemd.installed()
        if enable:
            self._systemd.enable(unit, self._tell)
        else:
            self._tell(f"start it with: systemctl enable --now {unit.unit}")

    def _check(self, unit: Unit) -> None:
        """Raise UserFacingError for what would keep the service from starting."""
        config = self._root / unit.config
        if config.exists():
            read_config(config)
        groups = self._root / "etc/group"
        if groups.exists() and not any(
            line.startswith(f"{udev.GROUP}:") for line in groups.read_text().splitlines()
        ):
            raise UserFacingError(
                f"{groups}: there is no group {udev.GROUP}, to which the sensors belong; make it "
                f"with: groupadd --system {udev.GROUP}"
            )

    def _program(self) -> bool:
        def tell(step: str) -> None:
            self._tell(f"{self._root / FOLDER}: {step} ...")

        return self._told(FOLDER, install_program(self._root, tell))

    def _file(self, path: Path, text: str) -> bool:
        return self._told(path, write_file(self._root / path, text))

    def _config(self, unit: Unit) -> None:
        """What an owner has written is never touched."""
        path = self._root / unit.config
        if path.exists():
            self._tell(f"{path}: kept as it is")
        else:
            self._file(unit.config, text_of("kinect.toml"))

    def _told(self, path: Path, is_new: bool) -> bool:
        self._tell(f"{self._root / path}: {'written' if is_new else 'was there already'}")
        return is_new


class Remover:
    """Takes away what `Installer` wrote below `root`."""

    def __init__(self, root: Path, systemd: Systemd | Offline, tell: Tell) -> None:
        self._root, self._systemd, self._tell = root, systemd, tell

    def uninstall(self, *, purge: bool) -> None:
        """Stop it and remove it; with `purge` also the configuration and all that it has written.

        Raises UserFacingError, OSError.
        """
        self._systemd.disable_all(self._root)
        drop_ins = sorted((self._root / UNIT_FOLDER).glob(f"kinect-vo*.service.d/{DROP_IN}"))
        for path in [*self._below(file.path for file in unit_files()), *drop_ins]:
            self._told(path, remove_file(path))
        for folder in {path.parent for path in drop_ins}:
            if not any(folder.iterdir()):
                folder.rmdir()
        for path in self._below(file.path for file in udev.system_files()):
            self._told(path, remove_file(path))
        self._told(self._root / COMMAND, unlink_command(self._root))
        self._systemd.removed()
        if purge:
            self._purge()
        elif (self._root / CONFIG_FOLDER).exists():
            self._tell(f"{self._root / CONFIG_FOLDER}: kept, with what is in /var; see --purge")
        self._told(self._root / FOLDER, remove_program(self._root))

    def _purge(self) -> None:
        written = [
            path
            for folder in KEPT
            for pattern in ("kinect-vo", "kinect-vo-*")
            for path in sorted((self._root / folder).glob(pattern))
        ]
        for path in [self._root / CONFIG_FOLDER, *written]:
            if path.is_symlink():
                path.unlink()
            elif path.is_dir():
                shutil.rmtree(path)
            else:
                continue
            self._told(path, True)

    def _below(self, paths: Iterable[Path]) -> list[Path]:
        return [self._root / path for path in paths]

    def _told(self, path: Path, is_gone: bool) -> None:
        self._tell(f"{path}: {'removed' if is_gone else 'was not there'}")
