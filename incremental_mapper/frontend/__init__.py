"""Front end: raw scans, fixes and samples in, odometry, positions and IMU spans out.

Each sensor is prepared by itself. Nothing in here knows of clusters, candidates or the graph.
"""
