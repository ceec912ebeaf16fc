"""Frames written in the layouts of other benchmarks."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, format_pose_line

# The y axes of ICL-NUIM's camera and world point up.
MIRRORED_Y = np.diag([1.0, -1.0, 1.0, 1.0])
Color = NDArray[np.uint8]
Depth = NDArray[np.uint16]
Frame = tuple[Color, Depth, Array]  # color BGR, depth in millimeters, T_world_camera
LayoutWriter = Callable[[Path, Sequence[Frame]], None]


def save(path: Path, image: Color | Depth) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def save_matrix(path: Path, matrix: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix)


def write_icl_nuim(folder: Path, frames: Sequence[Frame]) -> None:
    """Frame 0 has no true pose, as in the benchmark; poses have their y axes up."""
    associations, poses = [], []
    for number, (color, depth, T) in enumerate(frames):
        save(folder / f"rgb/{number}.png", color)
        save(folder / f"depth/{number}.png", depth * np.uint16(5))
        associations.append(f"{number} depth/{number}.png {number} rgb/{number}.png\n")
        line = format_pose_line(number, MIRRORED_Y @ T @ MIRRORED_Y)
        poses.append(line.replace(".000000 ", " ", 1))
    (folder / "associations.txt").write_text("".join(associations))
    (folder / "livingRoom2.gt.freiburg").write_text("".join(poses[1:]))


def write_seven_scenes(folder: Path, frames: Sequence[Frame]) -> None:
    """Poses are those of the depth camera; a pixel without a reading has 65535."""
    for number, (color, depth, T) in enumerate(frames):
        save(folder / f"frame-{number:06d}.color.png", color)
        save(folder / f"frame-{number:06d}.depth.png", np.where(depth == 0, 65535, depth))
        save_matrix(folder / f"frame-{number:06d}.pose.txt", T)


def write_redwood(folder: Path, frames: Sequence[Frame]) -> None:
    """Names begin with 1, the poses with 0."""
    blocks = []
    for number, (color, depth, T) in enumerate(frames):
        save(folder / f"color/{number + 1:05d}.jpg", color)
        save(folder / f"depth/{number + 1:05d}.png", depth)
        rows = "\n".join(" ".join(f"{value:.8f}" for value in row) for row in T)
        blocks.append(f"{number}\t{number}\t{number + 1}\n{rows}\n")
    (folder / "trajectory.log").write_text("".join(blocks))


def write_scannet(folder: Path, frames: Sequence[Frame]) -> None:
    """Color has twice the pixels of depth; the second frame has no pose."""
    for number, (color, depth, T) in enumerate(frames):
        save(folder / f"color/{number}.jpg", np.kron(color, np.ones((2, 2, 1), np.uint8)))
        save(folder / f"depth/{number}.png", depth)
        pose = np.full((4, 4), -np.inf) if number == 1 else T
        save_matrix(folder / f"pose/{number}.txt", pose)
    K = np.array([[525.0, 0, 319.5, 0], [0, 525.0, 239.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    K_color = np.diag([2.0, 2.0, 1.0, 1.0]) @ K
    K_color[:2, 2] += 0.5
    for name, intrinsics in (("color", K_color), ("depth", K)):
        save_matrix(folder / f"intrinsic/intrinsic_{name}.txt", intrinsics)
        save_matrix(folder / f"intrinsic/extrinsic_{name}.txt", np.eye(4))


WRITERS: dict[str, LayoutWriter] = {
    "ICL-NUIM": write_icl_nuim,
    "7-Scenes": write_seven_scenes,
    "Redwood": write_redwood,
    "ScanNet": write_scannet,
}
