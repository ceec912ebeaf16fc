"""Diagnosis of the computer and of the camera, of ``kinect-vo doctor``."""
