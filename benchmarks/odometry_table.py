"""The figures of an odometry run, and their table."""

from dataclasses import dataclass

from vo_service.tools.evaluation import Evaluation

STAGES = ("surf", "points", "match", "ransac", "svd")


@dataclass(frozen=True)
class OdometryResult:
    """Result of one method on one folder.

    Attributes:
        frames: Number of frames.
        failed: Frames without a pose.
        inliers: Median over the frames with a pose.
        stage_ms: Median CPU time by stage.
        cpu_ms: Median CPU time of a frame.
        evaluation: None without ground truth.
    """

    frames: int
    failed: int
    inliers: float
    stage_ms: dict[str, float]
    cpu_ms: float
    evaluation: Evaluation | None


def format_table(results: dict[str, OdometryResult]) -> str:
    """Format one line for each method; then ratios to SIFT, if it is one of them."""
    heads = ["frames", "failed", "inliers", "ATE", "global", "RPE/frame", "RPE/1s", "cover %"]
    heads += [*STAGES, "CPU ms"]
    rows = {name: table_cells(result) for name, result in results.items()}
    if "SIFT" in results:
        for name in (name for name in results if name != "SIFT"):
            rows[f"{name}/SIFT"] = ratio_cells(results[name], results["SIFT"])
    lines = [f"{'':10}" + "".join(f"{head:>10}" for head in heads)]
    lines += [f"{name:10}" + "".join(f"{cell:>10}" for cell in row) for name, row in rows.items()]
    return "\n".join(lines)


def table_cells(result: OdometryResult) -> list[str]:
    """The columns of one method."""
    counts = [f"{result.frames}", f"{result.failed}", f"{result.inliers:.0f}"]
    errors = [f"{1e3 * e:.1f}" if e is not None else "-" for e in errors_m(result)]
    covered = result.evaluation.coverage if result.evaluation else None
    times_ms = [*(result.stage_ms[name] for name in STAGES), result.cpu_ms]
    share = "-" if covered is None else f"{100 * covered:.1f}"
    return [*counts, *errors, share, *(f"{spent:.2f}" for spent in times_ms)]


def ratio_cells(result: OdometryResult, other: OdometryResult) -> list[str]:
    """The same columns as ratios to those of another method."""
    errors = [
        f"{mine / theirs:.2f}" if mine is not None and theirs else "-"
        for mine, theirs in zip(errors_m(result), errors_m(other), strict=True)
    ]
    stages = [f"{result.stage_ms[s] / max(other.stage_ms[s], 1e-9):.2f}" for s in STAGES]
    inliers = f"{result.inliers / max(other.inliers, 1.0):.2f}"
    return ["", "", inliers, *errors, "", *stages, f"{result.cpu_ms / other.cpu_ms:.2f}"]


def errors_m(result: OdometryResult) -> list[float | None]:
    """ATE, mean global error, RPE per frame and per second, in meters."""
    e = result.evaluation
    if e is None:
        return [None] * 4
    return [e.ate_rmse_m, e.mean_global_error_m, e.rpe_frame_m, e.rpe_1s_m]
