"""Catalog of the sequences of the TUM RGB-D benchmark.

Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012. Lengths and sizes
are for information only; some sizes are measured, the others are estimated from the length.
"""

import difflib
import re
from dataclasses import dataclass

from drivers.core import InputError

BENCHMARK_URL = "https://cvg.cit.tum.de/rgbd/dataset"
VALIDATION_SUFFIX = "_validation"

# Name, seconds, archive in megabytes.
_WITH_GROUND_TRUTH = """
fr1/360 29 430
fr1/desk 23 344
fr1/desk2 25 349
fr1/floor 50 735
fr1/plant 42 620
fr1/room 49 782
fr1/rpy 28 410
fr1/teddy 51 760
fr1/xyz 30 448
fr2/360_hemisphere 91 1700
fr2/360_kidnap 48 910
fr2/coke 85 1600
fr2/desk 99 1893
fr2/desk_with_person 142 2600
fr2/dishes 101 1900
fr2/flowerbouquet 99 1900
fr2/flowerbouquet_brownbackground 77 1500
fr2/large_no_loop 112 2200
fr2/large_with_loop 173 3300
fr2/metallic_sphere 76 1400
fr2/metallic_sphere2 62 1200
fr2/pioneer_360 73 780
fr2/pioneer_slam 156 1900
fr2/pioneer_slam2 116 1400
fr2/pioneer_slam3 112 1600
fr2/rpy 110 2100
fr2/xyz 123 2202
fr3/cabinet 39 500
fr3/large_cabinet 34 480
fr3/long_office_household 87 1484
fr3/nostructure_notexture_far 16 200
fr3/nostructure_notexture_near_withloop 38 470
fr3/nostructure_texture_far 16 200
fr3/nostructure_texture_near_withloop 56 900
fr3/sitting_halfsphere 37 620
fr3/sitting_rpy 27 460
fr3/sitting_static 24 400
fr3/sitting_xyz 43 700
fr3/structure_notexture_far 27 360
fr3/structure_notexture_near 36 470
fr3/structure_texture_far 32 521
fr3/structure_texture_near 37 600
fr3/teddy 81 1400
fr3/walking_halfsphere 36 600
fr3/walking_rpy 31 510
fr3/walking_static 25 420
fr3/walking_xyz 29 480
"""
# Sequences with a validation variant without ground truth, for the benchmark's online evaluation.
_WITH_VALIDATION = {
    "1": "360 desk desk2 plant room rpy xyz",
    "2": "360_hemisphere 360_kidnap desk desk_with_person pioneer_360 rpy xyz",
    "3": "cabinet large_cabinet long_office_household nostructure_notexture_far "
    "nostructure_notexture_near_withloop nostructure_texture_far "
    "nostructure_texture_near_withloop sitting_halfsphere sitting_rpy sitting_static sitting_xyz "
    "structure_notexture_far structure_notexture_near structure_texture_far "
    "structure_texture_near walking_halfsphere walking_rpy walking_static walking_xyz",
}
# Spellings of fr1/xyz: freiburg1_xyz, rgbd_dataset_freiburg1_xyz, rgbd_dataset_freiburg1_xyz.tgz.
_NAME_PATTERN = re.compile(r"(?:rgbd_dataset_)?(?:fr|freiburg)([123])[/_](\w+?)(?:\.tgz)?/?")


@dataclass(frozen=True)
class BenchmarkSequence:
    """Sequence of the camera freiburg1, 2 or 3; None for an unknown length or size."""

    camera: str
    title: str
    seconds: int | None
    megabytes: int | None

    @property
    def name(self) -> str:
        """Name for the command, such as fr1/xyz."""
        return f"fr{self.camera}/{self.title}"

    @property
    def folder(self) -> str:
        """Name of its folder, which also identifies its camera."""
        return f"rgbd_dataset_freiburg{self.camera}_{self.title}"

    @property
    def has_ground_truth(self) -> bool:
        """Whether it has a ground truth."""
        return not self.title.endswith(VALIDATION_SUFFIX)

    def url(self, source: str) -> str:
        """Return the address of its archive below `source`, a mirror of the benchmark's host."""
        return f"{source.rstrip('/')}/freiburg{self.camera}/{self.folder}.tgz"


def _parse_sequence(line: str) -> BenchmarkSequence:
    name, seconds, megabytes = line.split()
    return BenchmarkSequence(name[2], name[4:], int(seconds), int(megabytes))


SEQUENCES = (
    *(_parse_sequence(line) for line in _WITH_GROUND_TRUTH.split("\n") if line),
    *(
        BenchmarkSequence(camera, title + VALIDATION_SUFFIX, None, None)
        for camera, titles in _WITH_VALIDATION.items()
        for title in titles.split()
    ),
)


def find_sequence(name: str) -> BenchmarkSequence:
    """Return a sequence by name, in any common spelling. Raises InputError with similar names."""
    spelling = _NAME_PATTERN.fullmatch(name.lower())
    short_name = f"fr{spelling[1]}/{spelling[2]}" if spelling else name.lower()
    by_name = {sequence.name: sequence for sequence in SEQUENCES}
    if short_name in by_name:
        return by_name[short_name]
    similar = difflib.get_close_matches(short_name, by_name, n=3, cutoff=0.5)
    suggestion = f"did you mean {' or '.join(similar)}? " if similar else ""
    raise InputError(
        f"no sequence {name!r}; {suggestion}`kinect-vo download --list` shows them all"
    )
