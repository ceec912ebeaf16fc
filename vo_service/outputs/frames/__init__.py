"""Output of frames over Zenoh: images, points, accelerometer."""
