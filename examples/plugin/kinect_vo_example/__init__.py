"""A camera and an output for kinect-vo."""
