"""Cameras of libfreenect: the Kinect, and recordings of it played by fakenect."""
