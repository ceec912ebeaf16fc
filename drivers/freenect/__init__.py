"""Microsoft Kinect through libfreenect."""
