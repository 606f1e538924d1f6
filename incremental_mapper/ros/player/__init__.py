"""Player: a bag on ROS topics at its own pace, for installations without rosbag2.

Knows messages, not what is in them: nothing of the mapper or its libraries is loaded.
"""
