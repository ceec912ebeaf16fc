"""The up direction and the floor, which keep `odom` level."""
