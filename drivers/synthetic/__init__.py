"""A virtual Kinect: a furnished room, ray-cast, with the sensor's own faults and exact truth."""
