"""Parts of the keyframe odometry, see `vo_service.odometry.direct.odometry`."""
