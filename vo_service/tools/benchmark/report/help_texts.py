"""Explanations of the report for readers who do not know the project."""

INTRODUCTION_TEXT = (
    "Visual odometry estimates the motion of a camera from its images only. It estimates a small "
    "motion from each frame to the next and adds these motions up. Such a trajectory drifts, "
    "because the errors add up, too. This page compares methods on recordings of an RGB-D camera "
    "(color, and the distance of every pixel). If the true trajectory of a recording is known, "
    "the page shows the error of each method. It shows the time of each method in all cases."
)
ERROR_TEXT = (
    "Mean distance between the estimated and the true camera, with both trajectories aligned at "
    "the first frame. Smaller is better; the best of a row is bold. A percentage is the fraction "
    "of frames with a pose, if it is not nearly all: over few frames a small error means little, "
    "and below 90 % a method is never the best."
)
TIME_TEXT = (
    "CPU is the processor time of all frames, wall is the elapsed time on this computer. Reading "
    "and decoding of the images do not count. The runs were made one after another, each on one "
    "thread. Other running programs increase the wall time, but hardly the CPU time."
)
LOOP_CLOSURE_TEXT = (
    "A place that is seen again shows how far the camera has drifted since. The columns "
    "“optimized” are the errors of each method's trajectory after optimization with all loop "
    "closures; “loops” is the number of loop closures. The milliseconds are the processor time of "
    "loop closure, in addition to that of the method. The method and its time do not change."
)
PAPER_TEXT = (
    "The columns “paper” are the results of the paper on the same sequence (Fontes and Maia, "
    "“Visual odometry for moving RGB-D cameras”; Matlab on a Core i3 with 1.7 GHz, so the times "
    "are of another program on another computer)."
)
SFM_SCALE_TEXTS = {
    "first-depth": (
        "The color-only method (SfM) has no metric scale: its first scale comes from the first "
        "depth images; it must maintain this scale from there."
    ),
    "ground-truth": (
        "The color-only method (SfM) has no metric scale: its first scale comes from the ground "
        "truth; it must maintain this scale from there."
    ),
}
METRIC_TEXTS = (
    (
        "coverage",
        "Fraction of the frames with a pose. With ground truth, only frames that have it count. "
        "Errors are taken over these frames only: a low error at low coverage means little.",
    ),
    ("lost frames", "Frames for which the method reported no motion."),
    (
        "new epochs",
        "Number of times that the method was reset. The motion in between is missing.",
    ),
    (
        "gross errors",
        "Steps from one pose to the next with an error of more than 5 cm or 3 degrees while the "
        "method reported that it was tracking: errors without a warning.",
    ),
    (
        "ATE",
        "Absolute trajectory error: root mean square distance from the truth after the best "
        "rotation and translation (without scaling) of the whole trajectory. It shows errors of "
        "the shape.",
    ),
    (
        "mean global error",
        "As in Table I: mean distance with the first frames aligned. It shows the drift as a robot "
        "has it.",
    ),
    (
        "RPE frame",
        "Relative pose error: root mean square error of the motion from one frame to the next, in "
        "millimeters and degrees.",
    ),
    ("RPE 1 s", "The same over one second: less noise, more drift."),
    (
        "CPU ms a frame",
        "Median processor time of one frame. At 30 frames a second, 33 ms are available.",
    ),
    ("memory", "Peak memory of the run's process."),
)
GAPS_TEXT = (
    "Here the recording itself pauses: frames are missing for longer than 0.2 s and three median "
    "frame periods. The camera moved meanwhile, so the next frame may show something else. “Kept "
    "tracking” means that the method matched frames across the pause. The error is that of the "
    "motion across the pause."
)
LOST_FRAMES_TEXT = "Reasons for lost frames, as the methods report them; # stands for a number."
