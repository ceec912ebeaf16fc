"""Parts of the keyframe odometry, see `vo_service.odometry.keyframe_odometry`."""
