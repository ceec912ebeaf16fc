"""Reader of binary PLY files."""

from pathlib import Path

import numpy as np

from vo_service.reconstruction.mesh import Mesh


def read_ply(path: Path) -> Mesh:
    """Read the mesh; every property is looked up by its name in the header."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    kinds = {"float": "<f4", "uchar": "u1"}
    words = [line.split() for line in lines]
    counts = {word[1]: int(word[2]) for word in words if word[0] == "element"}
    fields = [(w[2], kinds[w[1]]) for w in words if w[0] == "property" and len(w) == 3]
    assert ["property", "list", "uchar", "int", "vertex_indices"] in words
    vertices = np.frombuffer(body, fields, counts["vertex"])
    faces = np.frombuffer(body, [("n", "u1"), ("v", "<i4", 3)], counts["face"], vertices.nbytes)
    assert vertices.nbytes + faces.nbytes == len(body)
    assert np.all(faces["n"] == 3)

    def columns(*names: str) -> np.ndarray:
        return np.column_stack([vertices[name] for name in names])

    return Mesh(
        columns("x", "y", "z"),
        columns("nx", "ny", "nz"),
        columns("red", "green", "blue"),
        faces["v"],
    )
