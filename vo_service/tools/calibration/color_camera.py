"""Calibration of the color camera from views of a board: Zhang's method in OpenCV.

Zhang, A flexible new technique for camera calibration, IEEE PAMI 22(11), 2000.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from drivers.calibration import NO_DISTORTION
from drivers.core import UserFacingError
from drivers.core.geometry import Array, rigid_transform, so3_exp
from vo_service.tools.calibration.board import BoardCorners
from vo_service.tools.calibration.lens import Lens
from vo_service.tools.calibration.snapshot import BoardView

MIN_VIEWS = 6
# Groups of views for the jackknife: each fit leaves out one group.
JACKKNIFE_GROUPS = 10
# A corner is an outlier (glare, a finger) above this multiple of the median error.
MAX_CORNER_ERROR_RATIO = 6.0
MIN_CORNERS = 8
# A view is an outlier (a board that moved, was bent or was misdetected) if its error exceeds this
# multiple of the median error and the minimum below.
MAX_VIEW_ERROR_RATIO = 3.0
MIN_OUTLIER_ERROR_PX = 0.3
# A coefficient is used only if it is this many standard deviations from zero.
MIN_SIGNIFICANT_SIGMAS = 3.0
FIX_K3_FLAG = cv2.CALIB_FIX_K3
USE_GUESS_FLAG = cv2.CALIB_USE_INTRINSIC_GUESS
UNKNOWN_LENS = Lens(1.0, 1.0, 0.0, 0.0, NO_DISTORTION)
K3_INDEX = 8  # index in fx fy cx cy k1 k2 p1 p2 k3
TERMINATION_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9)


@dataclass(frozen=True)
class ColorCalibrationResult:
    """Fitted lens of the color camera, and the residuals of the views.

    Attributes:
        size: (width, height) of the images.
        lens: Intrinsics and distortion.
        sigma: (9,) standard deviations of fx fy cx cy (pixels) k1 k2 p1 p2 k3.
        rms_px: Root mean square reprojection error of the corners.
        views: The V views that were used.
        T_camera_board: (V, 4, 4) poses of the board.
        residuals_px: (N, 2) for each view: detected minus projected corners.
        rejected: Names of rejected views.
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
        """(V,) root mean square reprojection error of each view."""
        return np.array([np.sqrt((each**2).sum(axis=1).mean()) for each in self.residuals_px])


def calibrate_color(views: Sequence[BoardView]) -> ColorCalibrationResult:
    """Fit the lens without outlier views.

    Raises:
        UserFacingError: Too few views are left.
    """
    inliers, rejected = list(views), list[str]()
    while True:
        if len(inliers) < MIN_VIEWS:
            rejected_text = f", {len(rejected)} were rejected as outliers" if rejected else ""
            raise UserFacingError(
                f"only {len(inliers)} different views of the board{rejected_text}; at least "
                f"{MIN_VIEWS} are needed and 25 are good; show the board at other places and "
                "angles, and hold it still"
            )
        result = _fit(inliers, rejected)
        errors_px = result.view_rms_px
        limit_px = max(MAX_VIEW_ERROR_RATIO * float(np.median(errors_px)), MIN_OUTLIER_ERROR_PX)
        worst = int(np.argmax(errors_px))
        if errors_px[worst] <= limit_px:
            refined = _refit_without_outlier_corners(result)
            # If the views do not determine the focal length, as with boards that all face the
            # camera, the covariance from the normal matrix is far too small.
            sigma = jackknife_sigma([fit.lens.vector for fit in refit_without_groups(refined)])
            return replace(refined, sigma=np.maximum(refined.sigma, sigma))
        # Only one at a time, because a large outlier increases the errors of the other views.
        rejected.append(inliers.pop(worst).name)


def _refit_without_outlier_corners(color: ColorCalibrationResult) -> ColorCalibrationResult:
    """Fit again without outlier corners, if there are any."""
    distances_px = [np.linalg.norm(each, axis=1) for each in color.residuals_px]
    limit_px = max(
        MAX_CORNER_ERROR_RATIO * float(np.median(np.concatenate(distances_px))),
        MIN_OUTLIER_ERROR_PX,
    )
    is_inlier = [distances <= limit_px for distances in distances_px]
    if all(each.all() for each in is_inlier):
        return color
    views = [
        replace(view, corners=BoardCorners(view.corners.pixels[keep], view.corners.points_m[keep]))
        for view, keep in zip(color.views, is_inlier, strict=True)
        if np.count_nonzero(keep) >= MIN_CORNERS
    ]
    return _fit(views, color.rejected)


def refit_without_groups(color: ColorCalibrationResult) -> Iterator[ColorCalibrationResult]:
    """Fit again without each tenth of the views, with the same coefficients."""
    count = min(JACKKNIFE_GROUPS, len(color.views))
    flags = 0 if color.lens.distortion[-1] else FIX_K3_FLAG
    for group in range(count):
        views = [view for number, view in enumerate(color.views) if number % count != group]
        yield _fit_with_flags(views, color.rejected, flags | USE_GUESS_FLAG, color.lens)


def _fit(views: list[BoardView], rejected: list[str]) -> ColorCalibrationResult:
    """Fit with as many coefficients as the views determine."""
    full = _fit_with_flags(views, rejected, 0)
    k3 = full.lens.distortion[-1]
    is_significant = abs(k3) > MIN_SIGNIFICANT_SIGMAS * full.sigma[K3_INDEX]
    return full if is_significant else _fit_with_flags(views, rejected, FIX_K3_FLAG)


def _fit_with_flags(
    views: list[BoardView], rejected: list[str], flags: int, start: Lens = UNKNOWN_LENS
) -> ColorCalibrationResult:
    points = [view.corners.points_m.astype(np.float32) for view in views]
    pixels = [view.corners.pixels.astype(np.float32) for view in views]
    size = views[0].size
    rms_px, K, distortion, rotation_vectors, translations, sigma, *_ = cv2.calibrateCameraExtended(
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
            rigid_transform(so3_exp(np.ravel(rotation_vector)), np.ravel(translation))
            for rotation_vector, translation in zip(rotation_vectors, translations, strict=True)
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


def jackknife_sigma(fits: Sequence[Array]) -> Array:
    """Return standard deviations (P,) from fits (P,) that each leave out one of the groups.

    They include all variation between views, of any cause (Efron and Stein, The jackknife estimate
    of variance, Annals of Statistics 9(3), 1981).
    """
    deviations = np.asarray(fits) - np.mean(fits, axis=0)
    count = len(fits)
    sigma: Array = np.sqrt((count - 1) / count * (deviations**2).sum(axis=0))
    return sigma
