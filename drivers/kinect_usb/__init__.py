"""The Kinect's USB devices, motor, LED and accelerometer, through libusb."""
