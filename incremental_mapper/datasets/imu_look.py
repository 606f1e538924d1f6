"""A look at the first messages of several IMUs: which of them are sound."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from incremental_mapper.checks.imu_choice import implausible_imu
from incremental_mapper.datasets.bag_files import Topic
from incremental_mapper.datasets.bag_recovery import BagReader
from incremental_mapper.datasets.first_look import messages_of
from incremental_mapper.datasets.message_conversion import imu_from_message
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, ImuSample

SECONDS = 3 * NANOSECONDS
"""So long an IMU is looked at, by its stamps: whether gravity was taken out shows after 2 s."""
MOST = 2000
"""Messages that are looked at whatever their stamps say."""


def look_at_imus(reader: BagReader, topics: Sequence[Topic], gravity: float) -> dict[str, str]:
    """Look at the first seconds of each IMU.

    Args:
        reader: an open bag.
        topics: those of ``sensor_msgs/Imu``.
        gravity: magnitude of gravity, m/s^2.

    Returns:
        What is wrong with those that are not sound, by topic.
    """
    reasons = {topic.name: _reason(reader, topic, gravity) for topic in topics}
    return {topic: reason for topic, reason in reasons.items() if reason is not None}


def _reason(reader: BagReader, topic: Topic, gravity: float) -> str | None:
    samples: list[ImuSample] = []
    for count, message in enumerate(messages_of(reader, topic)):
        with suppress(MeasurementError):
            samples.append(imu_from_message(message))
        if count >= MOST or (samples and samples[-1].stamp - samples[0].stamp > SECONDS):
            break
    samples.sort(key=lambda sample: sample.stamp)
    return implausible_imu(
        np.array([sample.stamp for sample in samples], dtype=np.int64),
        np.array([sample.gyro for sample in samples]).reshape(-1, 3),
        np.array([sample.acceleration for sample in samples]).reshape(-1, 3),
        gravity,
    )
