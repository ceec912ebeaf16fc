"""What services that the tests start in processes of their own need before they can be quick."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.vo_service.played_service import KINECT_VO, START_LIMIT_S


@pytest.fixture(scope="session")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache for rendered rooms. The kernels, which all tests share, are compiled afterwards."""
    folder = tmp_path_factory.mktemp("films")
    environment = os.environ | {"CACHE_DIRECTORY": str(folder)}
    subprocess.run([KINECT_VO, "warm-up"], env=environment, check=True, timeout=START_LIMIT_S)
    return folder
