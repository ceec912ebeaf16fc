"""The files of a bag: those of a split recording in order, decompressed if they are compressed."""

import re
import shutil
import tempfile
import weakref
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path, PurePath

from backports import zstd
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from drivers.core import InputError
from drivers.core.input_files import open_input
from drivers.core.write_errors import is_disk_full
from drivers.recording.bag_names import is_bag_file

COMPRESSED_SUFFIX = ".zstd"
# A part of a recording: `rosbag record --split` and `ros2 bag record` count their files from 0.
PART_NAME = re.compile(r"(.*)_(\d+)(\.bag|\.db3|\.mcap)(\.active|\.zstd)?")


@dataclass(frozen=True)
class StorageFile:
    """One file of a bag.

    Attributes:
        path: The file of the recording, for messages.
        content: The file to read: the same, or its decompressed copy.
    """

    path: Path
    content: Path


class BagStorage:
    """The files of a bag. Decompressed copies are removed with this object.

    Args:
        path: A file, the folder of a bag, or several of them joined by commas.

    Attributes:
        files: The files in order of time.

    Raises:
        InputError: A file is missing or damaged, or a folder has files of several recordings.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        paths = find_files(path)
        folder = None
        if any(each.suffix == COMPRESSED_SUFFIX for each in paths):
            folder = Path(tempfile.mkdtemp(prefix="kinect-vo-bag-"))
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.files = [StorageFile(each, _content_of(each, folder)) for each in paths]

    @property
    def newest_file(self) -> Path:
        """The file that was changed last."""
        return max((each.path for each in self.files), key=lambda path: path.stat().st_mtime_ns)


def find_files(path: Path) -> list[Path]:
    """Find the files of a bag, in order of time.

    `metadata.yaml` lists those of a ROS 2 bag. Without it, because the recorder was killed, and in
    a folder of ROS 1 bags, the numbers of the parts count.

    Raises:
        InputError: A file is missing, or the files are not of one recording.
    """
    if not path.exists() and "," in str(path):
        return [file for part in str(path).split(",") for file in find_files(Path(part))]
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path")
    if not path.is_dir():
        return [path]
    names = {each.name for each in path.iterdir() if is_bag_file(each.name)}
    listed = _listed_names(path / "metadata.yaml")
    found = [_find_listed(path, name, names) for name in listed] or _order_parts(path, names)
    return [path / name for name in found]


def _listed_names(metadata: Path) -> list[str]:
    """Return the names in `metadata.yaml`; none if it is missing, empty or cut off."""
    try:
        contents = YAML(typ="safe").load(metadata.read_text())
        listed = contents["rosbag2_bagfile_information"]["relative_file_paths"]
        return [PurePath(each).name for each in listed]
    except (OSError, ValueError, YAMLError, LookupError, TypeError):
        return []


def _find_listed(folder: Path, name: str, names: Collection[str]) -> str:
    """Return the name of a listed file, which may have been decompressed by hand."""
    plain = name.removesuffix(COMPRESSED_SUFFIX)
    for each in (plain, plain + COMPRESSED_SUFFIX):
        if each in names:
            return each
    raise InputError(
        f"{folder / name}: no such file, but metadata.yaml lists it; restore it, or name one of "
        "the other files"
    )


def _order_parts(folder: Path, names: Collection[str]) -> list[str]:
    """Order the files of a folder by the numbers in their names."""
    files = [
        each for each in names if each.removesuffix(COMPRESSED_SUFFIX) not in {*names} - {each}
    ]
    if len(files) == 1:
        return files
    parts = {name: PART_NAME.fullmatch(name) for name in files}
    numbers = {int(part[2]): name for name, part in parts.items() if part}
    # The names of parts may have the time of their beginning.
    kinds = {(re.sub(r"\d", "", part[1]), part[3]) for part in parts.values() if part}
    if not files or len(numbers) < len(files) or len(kinds) > 1:
        what = ", ".join(sorted(files)) or "no files of messages"
        raise InputError(
            f"{folder}: holds {what}, which are not the numbered parts (NAME_0, NAME_1 ...) of one "
            "recording; name one file"
        )
    return [numbers[number] for number in sorted(numbers)]


def _content_of(path: Path, folder: Path | None) -> Path:
    """Return the file to read, after decompressing it into the folder. Raises InputError."""
    try:
        open_input(path).close()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; name another") from error
    if folder is None or path.suffix != COMPRESSED_SUFFIX:
        return path
    content = folder / path.stem
    try:
        with zstd.open(path, "rb") as compressed, content.open("wb") as file:
            shutil.copyfileobj(compressed, file, 1 << 20)
    except (OSError, EOFError, zstd.ZstdError) as error:
        if is_disk_full(error):
            raise InputError(
                f"{path}: {folder.parent} has no room for it without compression; set TMPDIR to a "
                "folder that has"
            ) from error
        raise InputError(f"{path}: cannot be decompressed: {error}; copy it again") from error
    return content
