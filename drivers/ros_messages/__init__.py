"""ROS 2 messages in plain CDR, encoded and decoded without ROS."""
