"""Direct RGB-D odometry against keyframes; it starts in `odometry.py`."""
