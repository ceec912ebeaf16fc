"""The color camera from views of a board: Zhang's method, as OpenCV has it.

Zhang, A flexible new technique for camera calibration, IEEE PAMI 22(11), 2000.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from drivers.calibration import NO_DISTORTION
from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array, rigid_transform, so3_exp
from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.least_squares import jackknife_sigma
from vo_service.tools.calibration.snapshot import BoardView, Lens

MIN_VIEWS = 6
# Parts of the views that are left out in turn, to see how much each matters.
JACKKNIFE_GROUPS = 10
# A corner is wrong (glare, a finger) if it is this many times the usual one off.
MAX_CORNER_ERROR_RATIO = 6.0
MIN_CORNERS = 8
# A view is wrong (a board that moved, bent or was misread) if its error is this many times the
# usual one, and large enough to matter.
MAX_VIEW_ERROR_RATIO = 3.0
MIN_OUTLIER_ERROR_PX = 0.3
# A coefficient is only used if it is this many standard deviations from zero.
MIN_SIGNIFICANT_SIGMAS = 3.0
FIX_K3_FLAG = cv2.CALIB_FIX_K3
USE_GUESS_FLAG = cv2.CALIB_USE_INTRINSIC_GUESS
UNKNOWN_LENS = Lens(1.0, 1.0, 0.0, 0.0, NO_DISTORTION)
K3_INDEX = 8  # its place among fx fy cx cy k1 k2 p1 p2 k3
TERMINATION_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9)


@dataclass(frozen=True)
class ColorCalibrationResult:
    """The lens, and how well the views agree with it.

    sigma           (9,) standard deviations of fx fy cx cy (pixels) k1 k2 p1 p2 k3
    rms_px          root mean square distance of corners from where the lens puts them
    views           those that were used, each with
    T_camera_board    (V, 4, 4) where the board was
    residuals_px      its corners found minus expected, (N, 2)
    rejected        names of views that were left out
    """

    size: tuple[int, int]
    lens: Lens
    sigma: Array
    rms_px: float
    views: list[BoardView]
    T_camera_board: Array
    residuals_px: list[Array]
    rejected: list[str]

    @property
    def view_rms_px(self) -> Array:
        """(V,) root mean square distance of each view's corners."""
        return _view_rms_px(self.residuals_px)


def calibrate_color(views: Sequence[BoardView]) -> ColorCalibrationResult:
    """Fit the lens, without the views that do not agree with the others.

    Raises UserFacingError if too few views are left.
    """
    kept, rejected = list(views), list[str]()
    while True:
        if len(kept) < MIN_VIEWS:
            left_out = f", {len(rejected)} were left out as wrong" if rejected else ""
            raise UserFacingError(
                f"only {len(kept)} different views of the board{left_out}; at least {MIN_VIEWS} "
                "are needed and 25 are good: show it at other places and angles, and hold it still"
            )
        found = _fit(kept, rejected)
        errors_px = found.view_rms_px
        limit_px = max(MAX_VIEW_ERROR_RATIO * float(np.median(errors_px)), MIN_OUTLIER_ERROR_PX)
        worst = int(np.argmax(errors_px))
        if errors_px[worst] <= limit_px:
            right = _refit_without_outlier_corners(found)
            return replace(right, sigma=np.maximum(right.sigma, _jackknife_lens_sigma(right)))
        # One at a time: a very wrong view spoils the errors of the others.
        rejected.append(kept.pop(worst).name)


def _refit_without_outlier_corners(color: ColorCalibrationResult) -> ColorCalibrationResult:
    """Fitted again without the corners that do not agree with the others, if there are any."""
    distances_px = [np.linalg.norm(each, axis=1) for each in color.residuals_px]
    limit_px = max(
        MAX_CORNER_ERROR_RATIO * float(np.median(np.concatenate(distances_px))),
        MIN_OUTLIER_ERROR_PX,
    )
    right = [distances <= limit_px for distances in distances_px]
    if all(each.all() for each in right):
        return color
    views = [
        replace(view, corners=BoardCorners(view.corners.pixels[keep], view.corners.points_m[keep]))
        for view, keep in zip(color.views, right, strict=True)
        if np.count_nonzero(keep) >= MIN_CORNERS
    ]
    return _fit(views, color.rejected)


def _jackknife_lens_sigma(color: ColorCalibrationResult) -> Array:
    """(9,) from fits that each leave out a tenth of the views.

    Where nothing but noise tells the focal length, as with boards that all face the camera, the
    normal matrix at the point that was found is sure of it, wrongly.
    """
    count = min(JACKKNIFE_GROUPS, len(color.views))
    fits = [refit_without_views(color, range(n, len(color.views), count)) for n in range(count)]
    return jackknife_sigma([fit.lens.vector for fit in fits])


def refit_without_views(
    color: ColorCalibrationResult, view_numbers: Sequence[int]
) -> ColorCalibrationResult:
    """Fitted again without some of its views, with the same coefficients."""
    views = [view for number, view in enumerate(color.views) if number not in view_numbers]
    flags = 0 if color.lens.distortion[-1] else FIX_K3_FLAG
    return _fit_with_flags(views, color.rejected, flags | USE_GUESS_FLAG, color.lens)


def _fit(views: list[BoardView], rejected: list[str]) -> ColorCalibrationResult:
    """With as many coefficients as the views can tell."""
    full = _fit_with_flags(views, rejected, 0)
    k3 = full.lens.distortion[-1]
    is_known = abs(k3) > MIN_SIGNIFICANT_SIGMAS * full.sigma[K3_INDEX]
    return full if is_known else _fit_with_flags(views, rejected, FIX_K3_FLAG)


def _fit_with_flags(
    views: list[BoardView], rejected: list[str], flags: int, start: Lens = UNKNOWN_LENS
) -> ColorCalibrationResult:
    points = [view.corners.points_m.astype(np.float32) for view in views]
    pixels = [view.corners.pixels.astype(np.float32) for view in views]
    size = views[0].size
    rms_px, K, distortion, turns, shifts, sigma, *_ = cv2.calibrateCameraExtended(
        points,
        pixels,
        size,
        start.K,
        np.array(start.distortion),
        flags=flags,
        criteria=TERMINATION_CRITERIA,
    )
    k1, k2, p1, p2, k3 = (float(value) for value in np.ravel(distortion))
    lens = Lens(
        float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), (k1, k2, p1, p2, k3)
    )
    poses = np.array(
        [
            rigid_transform(so3_exp(np.ravel(turn)), np.ravel(shift))
            for turn, shift in zip(turns, shifts, strict=True)
        ]
    )
    residuals_px = [
        view.corners.pixels - lens.project(pose, view.corners.points_m)
        for view, pose in zip(views, poses, strict=True)
    ]
    sigmas = np.asarray(sigma, np.float64).ravel()[: K3_INDEX + 1]
    return ColorCalibrationResult(
        size, lens, sigmas, rms_px, views, poses, residuals_px, list(rejected)
    )


def _view_rms_px(residuals_px: Sequence[Array]) -> Array:
    return np.array([np.sqrt((each**2).sum(axis=1).mean()) for each in residuals_px])
