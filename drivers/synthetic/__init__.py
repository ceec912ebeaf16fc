"""A virtual Kinect: a ray-cast furnished room, the sensor's errors, and exact ground truth."""
