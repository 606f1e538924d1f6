"""The player: a bag's messages on ROS topics, for installations without rosbag2."""
