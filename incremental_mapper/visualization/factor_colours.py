"""Colours of factors and variables in three-dimensional views; red, green, blue from 0 to 1."""

FACTOR_COLOURS = {
    'odometry': (0.9, 0.6, 0.0),
    'imu': (0.35, 0.7, 0.9),
    'gnss': (0.0, 0.6, 0.5),
    'imu_part': (0.6, 0.8, 0.9),
    'dead_reckoning': (0.6, 0.8, 0.9),
    'bridge': (0.8, 0.2, 0.2),
    'closure': (0.8, 0.6, 0.7),
}
"""By the name of the kind; others have that of poses."""
POSE_COLOUR = (0.1, 0.1, 0.1)
PRIOR_COLOUR = (0.8, 0.5, 0.7)
CLUSTER_COLOUR = (0.0, 0.45, 0.7)
"""Of clusters that hold several measurements."""
