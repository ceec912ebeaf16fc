"""The residual, Student's t, the likelihood and the prior are each written in one place."""

import ast
from collections.abc import Callable
from pathlib import Path

import pytest

import vo_service.odometry.direct as direct

FILES = [file for file in Path(direct.__file__).parent.glob("*.py") if file.name != "parameters.py"]


def is_brightness_residual(node: ast.AST) -> bool:
    """A difference whose second part is a product with a gain."""
    return (
        isinstance(node, ast.BinOp)
        and isinstance(node.op, ast.Sub)
        and isinstance(node.right, ast.BinOp)
        and isinstance(node.right.op, ast.Mult)
        and "gain" in ast.unparse(node.right).lower()
    )


def is_student(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id == "DEGREES_OF_FREEDOM"


def is_likelihood(node: ast.AST) -> bool:
    """The scale of a residual is part of a likelihood by its logarithm."""
    return isinstance(node, ast.Call) and ast.unparse(node).startswith("np.log(residual_model")


def is_prior(node: ast.AST) -> bool:
    """The motion prior is weighted by its information, an element at a time."""
    return isinstance(node, ast.Subscript) and ast.unparse(node).startswith("prior.information[")


@pytest.mark.parametrize(
    ("is_concept", "home"),
    [
        (is_brightness_residual, "factor.py"),
        (is_student, "factor.py"),
        (is_likelihood, "residuals.py"),
        (is_prior, "gauss_newton.py"),
    ],
)
def test_a_concept_is_written_once(is_concept: Callable[[ast.AST], bool], home: str) -> None:
    homes = {
        file.name for file in FILES if any(map(is_concept, ast.walk(ast.parse(file.read_text()))))
    }
    assert homes == {home}


def test_a_second_residual_is_found() -> None:
    second = ast.parse("r = brightness[i] - model[GAIN] * points[i, POINT_BRIGHTNESS]")
    assert any(map(is_brightness_residual, ast.walk(second)))
