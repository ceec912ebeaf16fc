"""A ROS 2 node that publishes what a running kinect-vo sends over Zenoh.

It depends on eclipse-zenoh and on the user's rclpy only, so it runs with any Python of ROS, on the
robot or on another computer.
"""
