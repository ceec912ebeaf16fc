"""The virtual Kinect: renders a furnished room as a real sensor would see it."""
