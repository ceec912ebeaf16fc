"""Calibration of the depth camera from planes of a board that the color camera sees.

Each depth reading on the board, as a point in the frame of the color camera, must lie in the
board's plane. This determines intrinsics, relative pose and scale together, if the board is seen
at many tilts, places and distances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core import UserFacingError
from drivers.core.geometry import Array
from vo_service.odometry.uncertainty import depth_sigma_m
from vo_service.tools.calibration.board import BoardLayout
from vo_service.tools.calibration.color_camera import (
    JACKKNIFE_GROUPS,
    MIN_SIGNIFICANT_SIGMAS,
    ColorCalibrationResult,
    jackknife_sigma,
    refit_without_groups,
)
from vo_service.tools.calibration.depth_model import (
    DISTORTION,
    PARAMETER_NAMES,
    BoardReadings,
    DepthModel,
    collect_board_readings,
)

# Maximum distances of inliers from the board's plane, in robust standard deviations: large while
# only default parameters are known, small at the end.
GATES = (10.0, 6.0, 4.0, 4.0)
# Median absolute deviation of normal noise, in standard deviations.
MEDIAN_ABS_NORMAL = 0.6745
# Above this multiple of the sensor's noise, the depth does not belong to the boards.
MAX_NOISE_RATIO = 6.0
MIN_VIEWS = 8
# Minimum fraction of readings that agree with the boards.
MIN_USED_FRACTION = 0.6
# A larger scale error means that the size of the squares or the unit of depth is wrong.
MAX_SCALE_ERROR = 0.12
ALL_PARAMETERS = np.arange(len(PARAMETER_NAMES))
WITHOUT_DISTORTION = np.delete(ALL_PARAMETERS, DISTORTION)

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class DepthCalibrationResult:
    """Fitted depth camera, and the residuals of the readings.

    Attributes:
        model: The depth camera.
        sigma: (13,) standard deviations, in the order of `depth_model.PARAMETER_NAMES`.
        pixels: N readings on the boards.
        residuals_m: (N,) distances of the readings from the board's plane.
        is_used: (N,) whether a reading is an inlier.
    """

    model: DepthModel
    sigma: Array
    pixels: BoardReadings
    residuals_m: Array
    is_used: NDArray[np.bool_]

    @property
    def rms_m(self) -> float:
        """Root mean square distance of the used readings from the board's plane."""
        return float(np.sqrt((self.residuals_m[self.is_used] ** 2).mean()))

    @property
    def view_count(self) -> int:
        """Number of views with a used reading."""
        return len(np.unique(self.pixels.view_number[self.is_used]))


def calibrate_depth(
    color: ColorCalibrationResult, layout: BoardLayout, depth_factor: float, progress: Progress
) -> DepthCalibrationResult:
    """Fit the depth camera to the boards that the color camera saw.

    Args:
        depth_factor: Values of the depth images per meter.
        progress: Is called with the number of steps done and in total.

    Raises:
        UserFacingError: The readings do not lie on the boards, or on too few boards.
    """
    fit = _DepthFit(layout, depth_factor)
    model = fit.refine(color, fit.estimate_initial(color), WITHOUT_DISTORTION, GATES)
    distorted = fit.refine(color, model, ALL_PARAMETERS, GATES[-1:])
    steps = 2 * min(JACKKNIFE_GROUPS, len(color.views))
    sigma = fit.jackknife_sigma(color, distorted, ALL_PARAMETERS, lambda n: progress(n, steps))
    if np.any(np.abs(distorted.vector[DISTORTION]) > MIN_SIGNIFICANT_SIGMAS * sigma[DISTORTION]):
        progress(steps, steps)
        model = distorted
    else:
        sigma = fit.jackknife_sigma(
            color, model, WITHOUT_DISTORTION, lambda n: progress(n + steps // 2, steps)
        )
    return _make_result(fit.collect_readings(color, model), model, sigma)


@dataclass(frozen=True)
class _DepthFit:
    """Common data of all fits of one calibration."""

    layout: BoardLayout
    depth_factor: float

    def estimate_initial(self, color: ColorCalibrationResult) -> DepthModel:
        """Return the default camera with the scale that moves its readings onto the boards."""
        height, width = color.views[0].depth_raw.shape
        default = DepthModel.default((width, height), 1.0)
        pixels = self.collect_readings(color, default)
        count = len(np.unique(pixels.view_number))
        if count < MIN_VIEWS:
            raise UserFacingError(
                f"only {count} of {len(color.views)} views have depth readings on the board; at "
                f"least {MIN_VIEWS} are needed; hold it 0.6 to 1.5 m away, out of the sun"
            )
        points_m = default.points_m(pixels.pixels, pixels.readings_m)
        ratios = pixels.offsets_m / (points_m * pixels.normals).sum(axis=1)
        scale = float(np.median(ratios))
        if abs(scale - 1.0) > MAX_SCALE_ERROR:
            raise UserFacingError(
                f"the board is {scale:.2f} times as far away as measured by depth; measure "
                "--square again, and check the recording's depth factor (--camera-file)"
            )
        return DepthModel.default((width, height), scale)

    def refine(
        self,
        color: ColorCalibrationResult,
        model: DepthModel,
        free: NDArray[np.int64],
        gates: Sequence[float],
    ) -> DepthModel:
        """Fit the parameters with indices `free`; the boards' outlines follow the model.

        Args:
            free: (P,) indices of the parameters to fit.
            gates: Maximum distance of inliers for each fit, in robust standard deviations.
        """
        from scipy.optimize import least_squares  # slow to import

        for gate in gates:
            pixels = self.collect_readings(color, model)
            weights = _is_used(pixels, model, gate) / depth_sigma_m(pixels.readings_m)
            fit = least_squares(
                lambda x, pixels, model, weights: (
                    pixels.residuals_m(model.with_parameters(free, x)) * weights
                ),
                model.vector[free], method="lm", x_scale="jac", args=(pixels, model, weights),
            )  # fmt: skip
            model = model.with_parameters(free, fit.x)
        return model

    def collect_readings(self, color: ColorCalibrationResult, model: DepthModel) -> BoardReadings:
        """Collect the readings on the boards, whose outlines follow from `model`."""
        views, poses = color.views, color.T_camera_board
        return collect_board_readings(views, poses, self.layout, model, self.depth_factor)

    def jackknife_sigma(
        self,
        color: ColorCalibrationResult,
        model: DepthModel,
        free: NDArray[np.int64],
        progress: Callable[[int], None],
    ) -> Array:
        """Return standard deviations (13,) from fits of both cameras without a tenth of the views.

        The covariance from the normal matrix would be ten times too small: errors within a view are
        correlated, and all views share the color camera's error.
        """
        fits = []
        for group, color_without_group in enumerate(refit_without_groups(color)):
            progress(group)
            fits.append(self.refine(color_without_group, model, free, GATES[-1:]).vector)
        return jackknife_sigma(fits)


def _make_result(pixels: BoardReadings, model: DepthModel, sigma: Array) -> DepthCalibrationResult:
    """Return the result. Raises UserFacingError if the depth does not belong to the boards."""
    is_used = _is_used(pixels, model, GATES[-1])
    noise = float(np.median(_normalized_distances(pixels, model))) / MEDIAN_ABS_NORMAL
    used_fraction = float(is_used.mean())
    if noise > MAX_NOISE_RATIO or used_fraction < MIN_USED_FRACTION:
        raise UserFacingError(
            f"depth does not agree with the boards that the color camera saw: {noise:.0f} times "
            f"the sensor's noise, {used_fraction:.0%} of the readings are usable; the board must "
            "be flat and still, and no image mirrored"
        )
    return DepthCalibrationResult(model, sigma, pixels, pixels.residuals_m(model), is_used)


def _is_used(pixels: BoardReadings, model: DepthModel, gate: float) -> NDArray[np.bool_]:
    """Return whether (N,) distances are below `gate` robust standard deviations."""
    distances = _normalized_distances(pixels, model)
    sigma = max(1.0, float(np.median(distances)) / MEDIAN_ABS_NORMAL)
    is_used: NDArray[np.bool_] = distances < gate * sigma
    return is_used


def _normalized_distances(pixels: BoardReadings, model: DepthModel) -> Array:
    """Return distances (N,) from the boards, in standard deviations of the sensor's noise."""
    distances: Array = np.abs(pixels.residuals_m(model)) / depth_sigma_m(pixels.readings_m)
    return distances
