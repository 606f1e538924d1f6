"""The ROS node: messages in, one worker that maps, topics and services out.

The only room that imports rclpy. Callbacks convert and buffer; the worker owns the mapper.
"""
