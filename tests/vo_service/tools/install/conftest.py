"""Tree to install into, and a small program without the libraries it needs."""

from importlib.metadata import distribution
from pathlib import Path

import pytest

from vo_service.tools.install import program


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Root of another computer's file system; the copied program is not run."""
    return make_tree(tmp_path / "tree", monkeypatch)


def make_tree(root: Path, patch: pytest.MonkeyPatch) -> Path:
    patch.setattr(program, "runtime_distributions", lambda: [distribution("kinect-vo")])
    patch.setattr(program, "_check_that_it_runs", lambda folder: None)
    (root / "etc").mkdir(parents=True)
    (root / "etc/group").write_text("root:x:0:\nplugdev:x:46:\n")
    return root
