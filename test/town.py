"""An invented street for the tests of closures: houses of all sizes, and what is seen of them."""

import gtsam
import numpy as np


def pose(x, y, degrees=0.0):
    return gtsam.Pose3(gtsam.Rot3.Yaw(np.radians(degrees)), np.array([x, y, 0.0]))


def wall(rng, start, end, height):
    along = rng.uniform(0.0, 1.0, (int(60 * np.hypot(*np.subtract(end, start))), 1))
    points = np.array(start) + along * np.subtract(end, start)
    return np.column_stack([points, rng.uniform(0.0, height, len(points))])


def town(seed):
    """Ground and houses of all sizes within 60 m, points (N, 3)."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-60.0, 60.0, (40_000, 2)), np.zeros(40_000)])
    parts = [ground]
    for side in (-1.0, 1.0):
        x = -60.0
        while x < 55.0:
            wide, back, tall = rng.uniform(4.0, 14.0), rng.uniform(8.0, 13.0), rng.uniform(4.0, 9.0)
            front = side * back
            parts.append(wall(rng, (x, front), (x + wide, front), tall))
            parts.append(wall(rng, (x, front), (x, front + side * 8.0), tall))
            x += wide + rng.uniform(0.0, 5.0)
    return np.vstack(parts)


def seen_points(points, true, number, share=0.4):
    """What is seen within 40 m of a pose, points (N, 3) in its frame; others for each number."""
    rng = np.random.default_rng(number)
    own = true.transformTo(points.T).T
    own = own[(np.linalg.norm(own, axis=1) < 40.0) & (rng.uniform(size=len(own)) < share)]
    return (own + rng.normal(scale=0.02, size=own.shape)).astype(np.float32)
