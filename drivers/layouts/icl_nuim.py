"""ICL-NUIM's TUM-compatible folders: ``associations.txt`` with depth first, by frame number.

Its intrinsics have a negative fy, which says that the y axes of camera and world point up. The
images are upright, so fy is positive here and the true poses are mirrored instead.
"""

from pathlib import Path

from drivers.calibration import NO_DISTORTION, CameraCalibration
from drivers.core import InputError
from drivers.core.trajectory_files import ICL_NUIM_SUFFIX, assumed_stamp, read_icl_nuim_trajectory
from drivers.layouts.contents import AT_30_HZ, FolderContents, make_image
from drivers.recording.recorded_frames import FramePair, RecordedFrames
from drivers.tum.index_files import read_associations, read_rows

ASSOCIATIONS_FILE = "associations.txt"
ICL_NUIM_CAMERA = CameraCalibration(640, 480, 481.2, 480.0, 319.5, 239.5, NO_DISTORTION, 5000.0)


def is_icl_nuim(folder: Path) -> bool:
    """Whether there are ICL-NUIM's poses, or associations of frame numbers with depth first."""
    if any(folder.glob(f"*{ICL_NUIM_SUFFIX}")):
        return True
    file = folder / ASSOCIATIONS_FILE
    if not file.is_file():
        return False
    try:
        rows = read_rows(file, "number depth number color")
    except InputError:
        return False  # opening it as a TUM folder tells the fault
    return bool(rows) and all(
        words[0].isdecimal() and words[2].isdecimal() and words[1].startswith("depth")
        for _, words in rows
    )


def read_icl_nuim(folder: Path) -> FolderContents:
    """Read the frames and the true poses, `*.gt.freiburg` or `groundtruth.txt`."""
    file = folder / ASSOCIATIONS_FILE
    if not file.exists():
        raise InputError(
            f"{file}: no such file; a folder of ICL-NUIM holds {ASSOCIATIONS_FILE}, with lines "
            "such as `0 depth/0.png 0 rgb/0.png`"
        )
    pairs = [
        FramePair(*(make_image(image.file, assumed_stamp(int(image.stamp))) for image in pair))
        for pair in ((each.color, each.depth) for each in read_associations(file))
    ]
    truth_files = [*sorted(folder.glob(f"*{ICL_NUIM_SUFFIX}")), folder / "groundtruth.txt"]
    truth_file = next((each for each in truth_files if each.exists()), None)
    truth = None if truth_file is None else read_icl_nuim_trajectory(truth_file)
    found = () if truth_file is None else (f"true poses {truth_file.name}, y axis turned down",)
    assumptions = ("the benchmark's camera", "depth factor 5000", AT_30_HZ, *found)
    return FolderContents(RecordedFrames(pairs), ICL_NUIM_CAMERA, truth, assumptions)
