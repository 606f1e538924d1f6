"""True poses that a bag brings itself."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.bag_recovery import BagReader
from incremental_mapper.datasets.message_conversion import header_stamp
from incremental_mapper.trajectory import Trajectory


def truth_of_topic(reader: BagReader, topic: str) -> Trajectory | None:
    """Read a topic of odometry as truth.

    Args:
        reader: An open bag.
        topic: Of ``nav_msgs/Odometry``.

    Returns:
        T_truth_base at the messages' stamps; None where no message holds a pose.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    connections = [c for c in reader.connections if c.topic == topic]
    for connection, _, data in reader.messages(connections=connections):
        message: Any = reader.deserialize(data, connection.msgtype)
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        row = [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
        if np.isfinite(row).all() and np.any(row[3:]):
            stamps.append(header_stamp(message))
            rows.append(row)
    if not rows:
        return None
    unique, order = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
    table = np.array(rows)[order]
    quaternions = Rotation.from_quat(table[:, 3:]).as_quat()
    return Trajectory(unique, table[:, :3], quaternions)
