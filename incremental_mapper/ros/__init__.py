"""ROS: the node, its client, and the player; messages in, updates out.

The only room that imports rclpy. Callbacks convert and hand on; one worker thread owns the mapper,
and what it tells is published by the executor's thread. Neither waits for the other.
"""
