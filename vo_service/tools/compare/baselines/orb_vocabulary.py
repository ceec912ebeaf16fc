"""Vocabularies of ORB descriptors in the text format of DBoW2 (Gálvez-López and Tardós 2012).

The first line has k, L, scoring and weighting; each further line has one node: its parent's number,
whether it is a word, the 32 bytes of its descriptor, and its weight. The root is number 0 and has
no line.
"""

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from drivers.core import InputError
from drivers.core.input_files import open_input

DESCRIPTOR_BYTES = 32
NODE_FIELDS = 2 + DESCRIPTOR_BYTES + 1
# Larger values are refused by DBoW2.
MAX_HEADER_VALUES = (20, 10, 5, 3)
MAX_LINE_BYTES = 1000

Descriptors = NDArray[np.uint8]


@dataclass(frozen=True)
class VocabularyFile:
    """A checked file with a vocabulary; `digest` is of its content."""

    path: Path
    digest: str

    def __str__(self) -> str:
        return f"{self.path.name} (sha256 {self.digest[:12]})"


def read_vocabulary_file(path: Path) -> VocabularyFile:
    """Check the header, the first node and the last one of a file.

    Raises:
        InputError: The file cannot be read, is truncated, or is not a vocabulary in text format.
    """
    try:
        with open_input(path) as file:
            fault = _find_fault(file)
            file.seek(0)
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"--orb-vocabulary {path}: cannot be read: {error.strerror}; give a DBoW2 vocabulary "
            "in text format, such as ORBvoc.txt"
        ) from error
    if fault:
        raise InputError(
            f"--orb-vocabulary {path}: {fault}; give a DBoW2 vocabulary in text format, such as "
            "ORBvoc.txt, unpacked"
        )
    return VocabularyFile(path.resolve(), digest)


def _find_fault(file: BinaryIO) -> str:
    """Return why a file is not a vocabulary; "" if it is one."""
    header = file.readline(MAX_LINE_BYTES).split()
    is_header = len(header) == len(MAX_HEADER_VALUES) and all(
        field.isdigit() and int(field) <= maximum
        for field, maximum in zip(header, MAX_HEADER_VALUES, strict=True)
    )
    if not is_header:
        return 'is not a vocabulary (its first line is not "k L scoring weighting")'
    if not _is_node(file.readline(MAX_LINE_BYTES)):
        return f"is not an ORB vocabulary (its second line does not have {NODE_FIELDS} numbers)"
    size = file.seek(0, io.SEEK_END)
    file.seek(max(0, size - MAX_LINE_BYTES))
    return "" if _is_node(file.read().rstrip().splitlines()[-1]) else "is truncated"


def _is_node(line: bytes) -> bool:
    *integers, weight = line.split() or [b""]
    try:
        float(weight)
    except ValueError:
        return False
    return len(integers) == NODE_FIELDS - 1 and all(field.isdigit() for field in integers)
