"""Messages: results as ROS messages, of whichever library has the types, and a bag of them.

The node publishes them with rclpy's types, and a run without ROS writes them with those of the bag
library: the numbers are made once, here.
"""
