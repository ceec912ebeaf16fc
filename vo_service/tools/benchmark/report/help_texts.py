"""What a reader who never saw the project must know of the figures: a sentence or two each."""

INTRODUCTION_TEXT = (
    "Visual odometry works out how a camera moves from its pictures alone: from each frame to the "
    "next it estimates a small motion, and adds these up. A trajectory found like this drifts, as "
    "the errors add up as well. This page compares methods of doing so on recordings of an RGB-D "
    "camera (color, and the distance of every pixel). Where the recording's true trajectory is "
    "known, it says how far off each method was; for all of them, how long it took."
)
ERROR_TEXT = (
    "How far the estimated camera is from the true one, on average over the frames, with both "
    "trajectories joined at the first frame. Smaller is better; the best of a row is bold. A "
    "percentage says how many of the frames a method placed, where it did not place nearly all: "
    "over few frames a small error means little, and below 90 % it is never the best."
)
TIME_TEXT = (
    "CPU is the processor time of all frames together, wall the time that passed meanwhile on this "
    "computer. Reading and decoding the images is not counted. The runs were made one after "
    "another, each on one thread; other programs at work make wall longer, and CPU hardly."
)
LOOP_CLOSURE_TEXT = (
    "A place that is seen again says how far the camera has drifted since. The columns “corrected” "
    "are of each method's trajectory as all the places that were seen again have corrected it in "
    "the end; “loops” counts how often one was. The milliseconds are the processor time that this "
    "took, beside that of the method. What the method says, and its time, are as without."
)
PAPER_TEXT = (
    "The columns “paper” hold what the paper reports of the same sequence (Fontes and Maia, "
    "“Visual odometry for moving RGB-D cameras”; Matlab on a Core i3 of 1.7 GHz: its times are "
    "of another program on another computer)."
)
SFM_SCALE_TEXTS = {
    "first-depth": (
        "The color-only method (SfM) has no scale of its own: its first metre is taken from the "
        "first depth images; it must carry it on from there."
    ),
    "ground-truth": (
        "The color-only method (SfM) has no scale of its own: its first metre is taken from the "
        "ground truth; it must carry it on from there."
    ),
}
METRIC_TEXTS = (
    (
        "coverage",
        "Share of the frames that got a pose. With ground truth, only frames that have it count. "
        "Errors are taken over these frames alone: a low error at low coverage means little.",
    ),
    ("lost frames", "Frames of which the method said that it found no motion."),
    (
        "new epochs",
        "How often the method gave up and began afresh. The way in between is missing "
        "from there on.",
    ),
    (
        "gross errors",
        "Steps from one pose to the next that are off by more than 5 cm or 3 degrees while the "
        "method called itself tracking: errors that nobody is warned of.",
    ),
    (
        "ATE",
        "Absolute trajectory error: root mean square distance from the truth after the whole "
        "trajectory has been turned and shifted (never scaled) to fit best. It judges the shape.",
    ),
    (
        "mean global error",
        "As in Table I: mean distance with the first frames joined. It judges the drift as a robot "
        "would see it.",
    ),
    (
        "RPE frame",
        "Relative pose error: root mean square error of the motion from one frame to the next, in "
        "millimetres and degrees.",
    ),
    ("RPE 1 s", "The same over one second: less noise, more drift."),
    (
        "CPU ms a frame",
        "Median processor time of one frame. At 30 frames a second there are 33 ms for each.",
    ),
    ("memory", "The most memory that the process of the run took."),
)
GAPS_TEXT = (
    "Here the recording itself pauses: frames are missing for longer than 0.2 s and three usual "
    "times from frame to frame. The camera moved on meanwhile, so the next frame may show "
    "something else. “Followed on” means that the method matched across the pause; the error is "
    "that of the motion across it."
)
LOST_FRAMES_TEXT = "Why frames were lost, in the methods' own words; # stands for a number."
