import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks.odometry import METHODS, make_odometry
from tests.forked_process import run_module
from tests.vo_service.odometry.synthetic_views import make_frame, render_corner
from vo_service.types import NullStageTimer

pytestmark = pytest.mark.subprocess


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return run_module("benchmarks", "odometry", *arguments)


def test_each_method_is_measured_on_each_folder(recording: Path) -> None:
    result = run(str(recording), "--json")
    assert result.returncode == 0, result.stderr
    results = json.loads(result.stdout)[str(recording)]
    assert list(results) == list(METHODS)
    for result in results.values():
        assert (result["frames"], result["failed"]) == (12, 0)
        assert 0 < result["evaluation"]["ate_rmse_m"] < 0.02
        assert list(result["stage_ms"]) == ["surf", "points", "match", "ransac", "svd"]
        assert min(result["stage_ms"].values()) > 0


def test_the_table_compares_with_sift(recording: Path) -> None:
    result = run(str(recording), "--methods", "SURF", "SIFT")
    first_words = [line.split()[0] for line in result.stdout.splitlines() if line]
    assert first_words == [str(recording), "frames", "SURF", "SIFT", "SURF/SIFT"]


def test_a_missing_folder_is_a_clear_error(tmp_path: Path) -> None:
    result = run(str(tmp_path / "missing"))
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1
    assert "missing" in result.stderr


@pytest.mark.parametrize("method", METHODS)
def test_every_method_accepts_a_black_image(method: str) -> None:
    odometry = make_odometry(method, NullStageTimer())
    view = render_corner(np.eye(4))
    black = make_frame(np.zeros_like(view.gray), view.depth_m.astype(np.float64))
    assert [odometry.estimate(f).ok for f in (view, black, view)] == [True, False, True]


@pytest.mark.parametrize("method", METHODS)
def test_descriptors_are_integers_that_float32_multiplies_exactly(method: str) -> None:
    odometry = make_odometry(method, NullStageTimer())
    descriptor = odometry._extractor.extract(render_corner(np.eye(4)).gray).descriptor
    assert len(descriptor) > 100
    assert descriptor.dtype == np.float32
    assert np.array_equal(descriptor, np.rint(descriptor))
    assert (descriptor.astype(np.float64) ** 2).sum(axis=1).max() < 2**23
