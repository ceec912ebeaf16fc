import json
from pathlib import Path

import pytest

from benchmarks.__main__ import main


def test_every_stage_of_a_recording_is_measured(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["surf_stages", str(recording), "--frames", "2", "--json"]) == 0
    stages = json.loads(capsys.readouterr().out)[str(recording)]
    layers = [name for name in stages if name.startswith("lobe")]
    assert layers[0] == "lobe 5, every 1 px"
    assert layers[-1] == "lobe 25, every 4 px"
    assert {"integral image", "selection", "image pyramid", "descriptors", "whole"} < set(stages)
    assert min(stages.values()) > 0


def test_a_folder_without_frames_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["surf_stages", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
