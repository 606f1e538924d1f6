"""A look at the first fixes of several receivers: which of them are of use."""

from collections.abc import Sequence
from itertools import islice

import numpy as np

from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.checks.receiver_choice import ReceiverLook, unsound_receivers
from incremental_mapper.config import GnssSettings
from incremental_mapper.datasets.bag_files import Topic
from incremental_mapper.datasets.bag_recovery import BagReader
from incremental_mapper.datasets.first_look import messages_of
from incremental_mapper.datasets.message_conversion import fix_from_message
from incremental_mapper.errors import MeasurementError

MOST = 600
"""Fixes of each that are looked at: ten minutes of 1 Hz, for some receivers find none at first."""


def look_at_receivers(
    reader: BagReader, topics: Sequence[Topic], settings: GnssSettings
) -> dict[str, str]:
    """Look at the first fixes of each receiver.

    Args:
        reader: an open bag.
        topics: those of ``sensor_msgs/NavSatFix``.
        settings: what makes a fix usable.

    Returns:
        What is wrong with those that are worse than another one, by topic.
    """
    return unsound_receivers({topic.name: _look(reader, topic, settings) for topic in topics})


def _look(reader: BagReader, topic: Topic, settings: GnssSettings) -> ReceiverLook:
    sigmas, seen = [], 0
    for message in islice(messages_of(reader, topic), MOST):
        seen += 1
        try:
            covariance = checked_covariance(fix_from_message(message), settings)
        except MeasurementError:
            continue
        sigmas.append(float(np.sqrt(max(covariance[0, 0], covariance[1, 1]))))
    sigma = float(np.median(sigmas)) if sigmas else np.nan
    return ReceiverLook(len(sigmas) / max(seen, 1), sigma)
