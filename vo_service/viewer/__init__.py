"""What the odometry sees and does, shown in Rerun by a process of its own."""
