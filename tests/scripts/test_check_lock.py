"""The check that every locked package can be installed without a compiler."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from scripts.check_lock import (
    TARGETS,
    Table,
    Target,
    find_problems,
    has_wheel,
    main,
    needed_packages,
)

DEBIAN_X86 = Target("x86_64", "3.11.2")
BOARD = Target("aarch64", "3.13.0")
CHECKOUT = Path(__file__).parents[2]


def wheel(name: str) -> Table:
    return {"wheels": [{"url": f"https://example.org/a/{name}.whl"}]}


def package(name: str, *dependencies: Table, **more: Any) -> Table:
    table: Table = {"name": name, "version": "1", "source": {"registry": "r"}}
    return {**table, "dependencies": list(dependencies), **wheel(f"{name}-1-py3-none-any"), **more}


def project(*dependencies: Table, **more: Any) -> Table:
    return package("project", *dependencies, source={"editable": "."}, **more)


def names(packages: list[Table], target: Target = DEBIAN_X86) -> list[object]:
    return [found["name"] for found in needed_packages(packages, target)]


def test_the_lock_file_of_this_checkout_has_only_wheels(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(CHECKOUT / "uv.lock") == 0
    assert len(capsys.readouterr().out.splitlines()) == len(TARGETS) == 6


@pytest.mark.parametrize(
    "tags",
    [
        "py3-none-any",
        "cp311-cp311-manylinux_2_28_x86_64",
        "cp311-cp311-manylinux_2_36_x86_64",
        "cp311-cp311-manylinux_2_5_x86_64.manylinux1_x86_64",
        "cp38-abi3-manylinux_2_17_x86_64.manylinux2014_x86_64",
        "py3-none-manylinux_2_31_x86_64",
    ],
)
def test_a_wheel_for_this_machine_counts(tags: str) -> None:
    assert has_wheel(wheel(f"a-1-{tags}"), DEBIAN_X86)


@pytest.mark.parametrize(
    "tags",
    [
        "cp312-cp312-manylinux_2_28_x86_64",
        "cp312-abi3-manylinux_2_28_x86_64",
        "cp311-cp311-manylinux_2_28_aarch64",
        "cp311-cp311-manylinux_2_39_x86_64",
        "cp311-cp311-musllinux_1_2_x86_64",
        "cp311-cp311-macosx_11_0_x86_64",
        "cp311-cp311-win_amd64",
    ],
)
def test_a_wheel_for_another_machine_does_not_count(tags: str) -> None:
    assert not has_wheel(wheel(f"a-1-{tags}"), DEBIAN_X86)


def test_a_package_without_wheels_is_reported() -> None:
    assert not has_wheel({"sdist": {"url": "https://example.org/a-1.tar.gz"}}, DEBIAN_X86)


def test_dependencies_of_dependencies_are_needed() -> None:
    lock = [project({"name": "a"}), package("a", {"name": "b"}), package("b", {"name": "a"})]
    assert names(lock) == ["a", "b"]


def test_extras_and_groups_of_the_project_are_needed() -> None:
    optional: Table = {"viewer": [{"name": "a"}]}
    groups: Table = {"dev": [{"name": "b"}]}
    root = project(**{"optional-dependencies": optional, "dev-dependencies": groups})
    assert names([root, package("a"), package("b"), package("unused")]) == ["a", "b"]


def test_only_requested_extras_of_a_dependency_are_needed() -> None:
    optional: Table = {"fast": [{"name": "b"}], "slow": [{"name": "c"}]}
    root = project({"name": "a"}, {"name": "a", "extra": ["fast"]})
    a = package("a", **{"optional-dependencies": optional})
    assert names([root, a, package("b"), package("c")]) == ["a", "b"]


def test_markers_select_by_machine_and_python() -> None:
    lock = [
        project(
            {"name": "a", "marker": "platform_machine == 'aarch64'"},
            {"name": "b", "marker": "python_full_version < '3.12'"},
            {"name": "c", "marker": "sys_platform == 'win32'"},
        ),
        *map(package, "abc"),
    ]
    assert names(lock, DEBIAN_X86) == ["b"]
    assert names(lock, BOARD) == ["a"]


def test_the_locked_version_is_checked() -> None:
    old, new = package("a", version="1"), package("a", version="2")
    lock = [project({"name": "a", "version": "2"}), old, new]
    assert needed_packages(lock, BOARD) == [new]


def test_a_package_without_a_wheel_is_reported_with_its_target(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "uv.lock"
    path.write_text(
        """
        [[package]]
        name = "project"
        source = { editable = "." }
        dependencies = [{ name = "a" }]
        [[package]]
        name = "a"
        version = "7"
        source = { registry = "r" }
        wheels = [{ url = "https://example.org/a-7-cp38-abi3-manylinux_2_28_x86_64.whl" }]
        """
    )
    assert main(path) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("uv.lock: a 7 has no wheel for Python 3.11 on aarch64")


def test_every_package_of_the_project_is_reached() -> None:
    lock = tomllib.loads((CHECKOUT / "uv.lock").read_text())
    reached = {p["name"] for target in TARGETS for p in needed_packages(lock["package"], target)}
    assert reached == {p["name"] for p in lock["package"]} - {"kinect-vo"}
    assert find_problems(lock) == []
