"""What libusb sees of a Kinect: its devices, the motor, the light and the accelerometer."""
