"""Live visual odometry for RGB-D cameras, as a service."""
