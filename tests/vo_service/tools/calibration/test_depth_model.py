"""The depth camera's model, which converts readings to points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import inverse, transform_points
from vo_service.tools.calibration.depth_model import DepthModel

models = st.builds(
    lambda focal, center, distortion, rotation, translation, scale: DepthModel(
        np.array([*focal, *center, *distortion, *rotation, *translation, scale])
    ),
    st.tuples(*[st.floats(500.0, 650.0)] * 2),
    st.tuples(st.floats(300.0, 340.0), st.floats(220.0, 260.0)),
    st.tuples(*[st.floats(-0.08, 0.08)] * 2),  # a stronger distortion may not be invertible
    st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    st.floats(0.9, 1.1),
)


@given(models, st.tuples(st.floats(0, 639), st.floats(0, 479)), st.floats(0.5, 5.0))
def test_the_point_of_a_reading_projects_to_its_pixel(
    model: DepthModel, pixel: tuple[float, float], reading_m: float
) -> None:
    point_m = model.points_m(np.array([pixel]), np.array([reading_m]))
    point_depth_m = transform_points(inverse(model.T_color_depth), point_m)
    assert point_depth_m[0, 2] == pytest.approx(model.scale * reading_m)
    np.testing.assert_allclose(model.lens.project(np.eye(4), point_depth_m)[0], pixel, atol=0.02)


def test_other_parameters_do_not_change() -> None:
    default = DepthModel.default((640, 480), 1.0)
    changed = default.with_parameters(np.array([2, 12]), np.array([300.0, 1.01]))
    assert (changed.lens.cx, changed.scale) == (300.0, 1.01)
    assert (changed.lens.cy, default.lens.cx) == (239.5, 319.5)
