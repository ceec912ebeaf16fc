"""Places: views that are kept, so that the camera knows where it has been."""
