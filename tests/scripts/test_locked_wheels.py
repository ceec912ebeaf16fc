"""The list of wheels that a robot without a network needs."""

from typing import Any

import pytest

from scripts.check_lock import TARGETS, Table, Target
from scripts.locked_wheels import format_requirements, main

DEBIAN_X86 = Target("x86_64", "3.11.2")
BOARD = Target("aarch64", "3.13.0")


def package(name: str, *tags: str, **more: Any) -> Table:
    wheels = [
        {"url": f"https://example.org/a/{name}-1-{tag}.whl", "hash": f"sha256:{tag}"}
        for tag in tags
    ]
    return {"name": name, "version": "1", "source": {"registry": "r"}, "wheels": wheels, **more}


def project(*needs: str, **more: Any) -> Table:
    dependencies = [{"name": name} for name in needs]
    return package("project", **{"source": {"editable": "."}, "dependencies": dependencies, **more})


def test_every_wheel_that_fits_is_listed_with_its_hash() -> None:
    tags = ("cp311-cp311-manylinux_2_28_x86_64", "cp311-cp311-manylinux_2_28_aarch64")
    lock = [project("a"), package("a", "py3-none-any", *tags)]
    (line,) = format_requirements(lock, DEBIAN_X86, ())
    assert line == f"a==1 --hash=sha256:py3-none-any --hash=sha256:{tags[0]}"


def test_requested_extras_are_listed_and_development_tools_never() -> None:
    optional: Table = {"rerun": [{"name": "b"}]}
    groups: Table = {"dev": [{"name": "c"}]}
    root = project("a", **{"optional-dependencies": optional, "dev-dependencies": groups})
    lock = [root, *(package(name, "py3-none-any") for name in "abc")]
    assert [line[0] for line in format_requirements(lock, BOARD, ())] == ["a"]
    assert [line[0] for line in format_requirements(lock, BOARD, ["rerun"])] == ["a", "b"]


@pytest.mark.parametrize("target", TARGETS, ids=str)
def test_the_lock_file_of_this_checkout_suits_every_robot(
    target: Target, capsys: pytest.CaptureFixture[str]
) -> None:
    main(target.machine, target.minor)
    few = capsys.readouterr().out.splitlines()
    main(target.machine, target.minor, "rerun")
    all_of_them = capsys.readouterr().out.splitlines()
    assert all("--hash=sha256:" in line for line in all_of_them)
    assert {line.split("==")[0] for line in few} >= {"numpy", "scipy", "eclipse-zenoh", "pyusb"}
    assert {line.split("==")[0] for line in all_of_them} - {
        line.split("==")[0] for line in few
    } >= {"rerun-sdk"}
    assert not any(line.startswith(("pytest==", "mypy==", "ruff==")) for line in all_of_them)
