"""Cameras of OpenNI2: PrimeSense sensors and the Kinect, and `.oni` recordings."""
