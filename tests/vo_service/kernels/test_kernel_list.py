"""The list of kernels is that of the source: `python -m scripts.list_kernels` writes it."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from vo_service.kernels.compilation import find_callees
from vo_service.kernels.kernel_list import read_kernel_list

ROOT = Path(__file__).resolve().parents[3]
# Runs all parts in one process; each kernel is loaded once.
LOAD_ALL = """
import json
from scripts.list_kernels import loaded_signatures, part_runs
from vo_service.cli.command_line import set_library_environment
from vo_service.kernels.compilation import ensure_compiled

set_library_environment()
ensure_compiled(list(part_runs()), lambda _progress: None)
print(json.dumps(loaded_signatures(lambda: [run() for run in part_runs().values()])))
"""


@pytest.mark.subprocess
def test_the_list_has_all_kernels_that_the_parts_call_and_no_others() -> None:
    output = subprocess.run([sys.executable, "-c", LOAD_ALL], stdout=subprocess.PIPE, check=True)
    called = {json.dumps(each) for each in json.loads(output.stdout)}
    listed = {each.signature.text for each in read_kernel_list() if each.is_called}
    assert called == listed, "run .venv/bin/python -m scripts.list_kernels"


def test_the_list_has_every_kernel_of_the_source() -> None:
    listed = {each.signature.kernel for each in read_kernel_list()}
    in_source = {
        f"{'.'.join(file.relative_to(ROOT).with_suffix('').parts)}.{node.name}"
        for package in ("drivers", "vo_service")
        for file in (ROOT / package).rglob("*.py")
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.FunctionDef)
        if any(isinstance(each, ast.Name) and each.id == "kernel" for each in node.decorator_list)
    }
    assert in_source <= listed


def test_every_other_kernel_of_the_list_is_called_by_one() -> None:
    every = read_kernel_list()
    signatures = [each.signature for each in every]
    callees = set().union(*find_callees(signatures).values())
    others = {number for number, each in enumerate(every) if not each.is_called}
    assert others <= callees
