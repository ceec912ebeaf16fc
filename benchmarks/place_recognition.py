"""Place recognition: recall, accuracy, cost and false matches; and training of its vocabulary."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, Variants, measure_cpu_ms, option
from benchmarks.rendered_sequences import GivenPoses, make_frame
from benchmarks.tracking import is_gross, open_frames, open_frames_with_truth, pose_error
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform
from drivers.synthetic.camera_motion import look_rotations, rotations_from_vectors
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.renderer import Renderer, RoomModel
from vo_service import slam
from vo_service.odometry.direct.motion import se3_log
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.slam.keyframe_database import (
    TRACKED_VELOCITY_SIGMA,
    KeyframeDatabase,
    MapKeyframe,
    QueryFrame,
)
from vo_service.slam.place_recognizer import PlaceRecognizer

# Each spot of a room has a first view, and others at these distances (m) and angles (degrees).
VIEW_OFFSETS = ((0.1, 5.0), (0.2, 10.0), (0.3, 20.0), (0.45, 30.0), (0.6, 40.0))
SPOTS_PER_ROOM = 6
# Speeds of the hand during a view, m/s and rad/s along each axis.
SPEEDS = np.repeat([0.15, 0.25], 3)
# Time between views of a recording.
VIEW_PERIOD_S = 0.5
TABLE = Table(
    *(18, "trials:8d", "candidates:12d", "verified:10d", "mm:7.1mm", "95 %:7.1mm", "max:7.1mm"),
    *("degrees:9.3f", "sigmas:8.1f", "wrong:7d"),
)
OUTPUT = Path(slam.__file__).with_name("vlad_vocabulary.npy")
CLUSTERS, FEATURES_PER_IMAGE, FRAME_STRIDE = 32, 500, 30
# k-means: most iterations, and number of attempts.
MAX_ITERATIONS, ATTEMPTS = 100, 3
Result = TypeVar("Result")


class PosedView(NamedTuple):
    """A frame with the pose and velocity of the camera."""

    scene: str  # room or recording; poses of two scenes cannot be compared
    frame: RgbdFrame
    T_world_camera: Array
    velocity: Array  # (6,) twist of the camera in its own axes, m/s and rad/s


def views_of_room(seed: int) -> Iterator[PosedView]:
    """Yield views of a furnished room from a moving hand."""
    rng = np.random.default_rng([seed, 77])
    poses = [pose for _ in range(SPOTS_PER_ROOM) for pose in poses_around(_random_pose(rng), rng)]
    velocities = [SPEEDS * rng.normal(size=6) for _ in poses]
    rate_hz = SyntheticConfig.rate_hz
    config = SyntheticConfig(seed=seed, duration_s=len(poses) / rate_hz)
    motion = GivenPoses(np.array(poses), rate_hz, np.array(velocities))
    renderer = Renderer(config, motion, RoomModel.build(config, motion, 1))
    for seq, (T_world_camera, velocity) in enumerate(zip(poses, velocities, strict=True)):
        images = renderer.render(seq)
        frame = make_frame(config, seq, seq / rate_hz, images)
        yield PosedView(f"room {seed}", frame, T_world_camera, velocity)


def _random_pose(rng: np.random.Generator) -> Array:
    """A random pose in the room, looking in any direction, a little down."""
    yaw, down, roll = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.45), rng.normal(0.0, 0.05)
    R = look_rotations(np.array([yaw]), np.array([down]), np.array([roll]))[0]
    return rigid_transform(R, rng.uniform([-1.3, -1.0, 1.0], [1.3, 1.0, 1.6]))


def poses_around(T_world_spot: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the pose, then poses at the distances and angles of VIEW_OFFSETS, mostly level."""
    yield T_world_spot
    for distance_m, degrees in VIEW_OFFSETS:
        axis, direction = rng.normal(size=3) * (0.5, 1.0, 0.3), rng.normal(size=3) * (1.0, 0.3, 1.0)
        R = rotations_from_vectors(np.radians(degrees) * axis[None] / np.linalg.norm(axis))[0]
        yield T_world_spot @ rigid_transform(R, distance_m * direction / np.linalg.norm(direction))


def views_of_recording(folder: Path) -> Iterator[PosedView]:
    """Yield the views of a recording. Raises InputError without a ground truth."""
    with open_frames_with_truth(folder) as (frames, truth):
        next_s = -np.inf
        for frame in frames:
            n = int(np.searchsorted(truth.stamps_s, frame.stamp_s - 1e-4))
            if frame.stamp_s < next_s or not 0 < n < len(truth) - 1:
                continue
            next_s = frame.stamp_s + VIEW_PERIOD_S
            T = truth.T_world_camera
            duration_s = truth.stamps_s[n + 1] - truth.stamps_s[n - 1]
            velocity = se3_log(inverse(T[n - 1]) @ T[n + 1]) / duration_s
            yield PosedView(folder.name, frame, T[n], velocity)


@dataclass(frozen=True)
class DescribedView:
    """A view as a query, and as a keyframe."""

    scene: str
    T_world_camera: Array
    query: QueryFrame
    keyframe: MapKeyframe

    def distance_to(self, other: "DescribedView") -> tuple[float, float]:
        """Distance (m) and angle (degrees) of the poses; infinite in another scene."""
        if self.scene != other.scene:
            return np.inf, np.inf
        return pose_error(self.T_world_camera, other.T_world_camera)


# Result of matching one view with one keyframe: the true distance (m) and angle (degrees) of their
# poses, infinite in different scenes; whether the keyframe was a candidate; the error of the match
# (m, degrees, standard deviations as RMS over six directions), NaN without a match.
Trial = tuple[float, float, bool, float, float, float]


class CpuTimer:
    """Processor time by task."""

    def __init__(self) -> None:
        self.times_ms: dict[str, list[float]] = {}

    def measure(self, what: str, work: Callable[[], Result]) -> Result:
        result, spent_ms = measure_cpu_ms(work, time.process_time)
        self.times_ms.setdefault(what, []).append(spent_ms)
        return result


@option("--rooms", nargs="*", type=int, default=list(range(201, 207)))
@option("--recordings", nargs="*", type=Path, default=[])
def measure(args: argparse.Namespace) -> None:
    """Recall, accuracy, cost and false matches of place recognition.

    Each room is a room of the virtual Kinect with views around a few spots. A recording has a view
    every half second, and a ground truth. Every view is also a keyframe, and every view is matched
    with every other keyframe of all scenes. A match is wrong if its error is above 5 cm or 3
    degrees, or if it is of another scene.
    """
    timer, recognizer = CpuTimer(), PlaceRecognizer()
    scenes = chain(map(views_of_room, args.rooms), map(views_of_recording, args.recordings))
    views: list[DescribedView] = []
    for scene in scenes:
        views += [
            _describe_view(recognizer, view, timer, len(views) + n) for n, view in enumerate(scene)
        ]
        print(f"described {views[-1].scene}", file=sys.stderr, flush=True)
    trials = [
        _run_trial(recognizer, view, other, timer)
        for view in views
        for other in views
        if view is not other
    ]
    _print_trials(np.array(trials).reshape(-1, 6))
    _measure_search(views, timer)
    for task, times_ms in timer.times_ms.items():
        middle, most = np.percentile(times_ms, (50, 99))
        print(f"{task}: {middle:.2f} ms of CPU, 99 % {most:.2f}")


def _describe_view(
    recognizer: PlaceRecognizer, posed_view: PosedView, timer: CpuTimer, number: int
) -> DescribedView:
    """Describe a view with the velocity of the odometry."""
    frame, sigma = posed_view.frame, np.repeat(TRACKED_VELOCITY_SIGMA, 3)
    velocity = posed_view.velocity + sigma * np.random.default_rng([3, number]).normal(size=6)
    query = timer.measure("query", lambda: recognizer.create_query(frame, velocity))
    T = posed_view.T_world_camera
    keyframe = timer.measure("keyframe", lambda: recognizer.create_keyframe(query, number, 0, T))
    return DescribedView(posed_view.scene, T, query, keyframe)


def _run_trial(
    recognizer: PlaceRecognizer, view: DescribedView, other: DescribedView, timer: CpuTimer
) -> Trial:
    """Match a view with the keyframe of another one."""
    distance, query = view.distance_to(other), view.query
    candidates = timer.measure(
        "candidates", lambda: list(recognizer.find_candidates(query, [other.keyframe]))
    )
    if not candidates:
        return (*distance, False, np.nan, np.nan, np.nan)
    match = timer.measure("verification", lambda: recognizer.verify(query, candidates[0]))
    if match is None:
        return (*distance, True, np.nan, np.nan, np.nan)
    if view.scene != other.scene:
        return (*distance, True, np.inf, np.inf, np.inf)
    T_keyframe_camera = inverse(other.T_world_camera) @ view.T_world_camera
    twist = se3_log(inverse(T_keyframe_camera) @ match.T_keyframe_camera)
    sigmas = float(np.sqrt(twist @ np.linalg.solve(match.covariance, twist) / 6.0))
    return (*distance, True, *pose_error(T_keyframe_camera, match.T_keyframe_camera), sigmas)


def _print_trials(trials: Array) -> None:
    """Print a row for trials (N, 6) at each of the offsets, further away, and of other scenes."""
    print(TABLE.head)
    is_other_scene = np.isinf(trials[:, 0])
    is_further = ~is_other_scene
    for distance_m, angle_deg in VIEW_OFFSETS:
        is_within = (trials[:, :2] <= 1.01 * np.array([distance_m, angle_deg])).all(axis=1)
        _print_row(f"to {distance_m:g} m, {angle_deg:g} deg", trials[is_further & is_within])
        is_further &= ~is_within
    _print_row("further", trials[is_further])
    _print_row("another scene", trials[is_other_scene])


def _print_row(name: str, trials: Array) -> None:
    verified = trials[~np.isnan(trials[:, 3])]
    error_m, error_deg, sigmas = verified[:, 3:].T
    figures: list[float | None] = [None] * 5
    if len(verified):
        figures = [
            *(*np.percentile(error_m, [50, 95]), error_m.max()),
            float(np.median(error_deg)),
            float(np.percentile(sigmas, 95)),
        ]
    counts = (len(trials), int(trials[:, 2].sum()), len(verified))
    print(TABLE.row(name, *counts, *figures, sum(map(is_gross, error_m, error_deg))))


def _measure_search(views: Sequence[DescribedView], timer: CpuTimer) -> None:
    """Search all keyframes for those similar to each view."""
    database = KeyframeDatabase(sum(each.keyframe.size_bytes for each in views))
    for each in views:
        database.add(each.keyframe)
    for each in views:
        search = partial(database.find_similar, each.query, len(database), lambda _: True)
        timer.measure("search", search)


@option("folders", nargs="+", type=Path, help="training recordings")
@option("--count", type=int, default=CLUSTERS, help="number of visual words")
@option("--output", type=Path, default=OUTPUT)
def train(args: argparse.Namespace) -> None:
    """Train the VLAD vocabulary of place recognition on recordings in TUM format.

    It writes vo_service/slam/vlad_vocabulary.npy: the integer centers of k-means clusters of SURF
    descriptors. The same folders give the same vocabulary. Measure place recognition on other
    recordings than these.
    """
    descriptors = np.concatenate([d for f in args.folders for d in extract_descriptors(f)])
    np.save(args.output, fit_centers(descriptors, args.count))
    print(f"{args.count} visual words of {len(descriptors)} features in {args.output}")


def extract_descriptors(folder: Path) -> Iterator[NDArray[np.float32]]:
    """Yield the SURF descriptors (N, 64) of evenly spaced frames of a recording."""
    extractor = SurfExtractor(FEATURES_PER_IMAGE)
    with open_frames(folder) as (frames, _):
        for frame in frames:
            if frame.seq % FRAME_STRIDE == 0:
                yield extractor.extract(frame.gray).descriptor


def fit_centers(descriptors: NDArray[np.float32], count: int) -> NDArray[np.int8]:
    """Cluster descriptors; returns centers (count, 64), sorted by their first component."""
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, 0.01)
    _, _, centers = cv2.kmeans(
        descriptors, count, np.empty(0), criteria, ATTEMPTS, cv2.KMEANS_PP_CENTERS
    )
    whole = np.clip(np.rint(centers), -127, 127).astype(np.int8)
    return whole[np.lexsort(whole.T[::-1])]


VARIANTS: Variants = {
    "measure": measure,
    "train": train,
}
