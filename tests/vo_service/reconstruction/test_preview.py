"""A preview of a growing map is a complete Rerun recording."""

from pathlib import Path

import numpy as np
import pytest

from tests.vo_service.outputs.rerun.rerun_recording import count_rows, is_complete
from tests.vo_service.reconstruction.scenes import CAMERA
from vo_service.outputs.rerun.preview import open_previews
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.reconstructor import PreviewFrame, PreviewMap
from vo_service.reconstruction.rerun_preview import ReconstructionScene


@pytest.mark.subprocess
@pytest.mark.rerun
def test_the_recording_has_each_camera_and_each_new_mesh(seen_ball: Mesh, tmp_path: Path) -> None:
    recording = tmp_path / "map.rrd"
    lines: list[str] = []
    empty_map = PreviewMap(Mesh.empty(), np.zeros((1, 3)))
    ball_map = PreviewMap(seen_ball, np.zeros((2, 3)))
    with open_previews(
        (str(recording),), "test", lambda: ReconstructionScene, lines.append
    ) as previews:
        (preview,) = previews
        for seq, preview_map in enumerate([empty_map, empty_map, ball_map, ball_map]):
            preview.show(PreviewFrame(seq, CAMERA, np.eye(4), preview_map))
    assert lines == [f"Rerun: {recording}"]
    assert is_complete(recording)
    logged = count_rows(recording)
    assert [logged[f"/world/{name}"] for name in ("surface", "path")] == [2, 2]
    assert logged["/world/camera"] == 2 * 4  # transform and pinhole


def test_without_a_target_nothing_is_shown() -> None:
    with open_previews((), "test", lambda: ReconstructionScene, pytest.fail) as previews:
        assert not previews
