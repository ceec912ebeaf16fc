"""Layout of Rerun's window. Imports rerun: load it lazily."""

import rerun.blueprint as rrb

# Entity paths, shared with the code that logs to them.
WORLD = "world"
CAMERA = "world/camera"
IMAGE = "world/camera/image"
FEATURES = "world/camera/image/features"
INLIERS = "world/camera/image/inliers"
OUTLIERS = "world/camera/image/outliers"
POINTS = "world/camera/points"
TRAJECTORY = "world/trajectory"
GROUND_TRUTH = "world/ground_truth"
MAP = "world/map"
SCAN = "world/scan"
GRID = "world/grid"
DEPTH = "depth"
COUNTS = "plots/counts"
STAGES = "plots/stages"
TIMING = "plots/timing"
LOG = "log"

TIMELINE = "frame"


def make_blueprint() -> rrb.Blueprint:
    """Make the layout: 3-D view on the left; images, plots and log on the right."""
    scene = rrb.Spatial3DView(
        name="Camera, trajectory, map and ground truth",
        origin=WORLD,
        # The image has its own pane; here the frustum is enough.
        contents=[
            f"{WORLD}/**",
            f"- {FEATURES}",
            f"- {INLIERS}",
            f"- {OUTLIERS}",
        ],
    )
    pictures = rrb.Horizontal(
        rrb.Spatial2DView(name="Color: features and matches", origin=IMAGE),
        rrb.Spatial2DView(name="Depth", origin=DEPTH),
    )
    plots = rrb.Horizontal(
        rrb.TimeSeriesView(name="Features, matches, inliers", origin=COUNTS),
        rrb.TimeSeriesView(name="CPU ms by stage", origin=STAGES),
        rrb.TimeSeriesView(name="Sensor timing, ms", origin=TIMING),
    )
    log = rrb.TextLogView(name="State", origin=LOG)
    return rrb.Blueprint(
        rrb.Horizontal(
            scene,
            rrb.Vertical(pictures, plots, log, row_shares=[4, 3, 1.5]),
            column_shares=[5, 6],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
