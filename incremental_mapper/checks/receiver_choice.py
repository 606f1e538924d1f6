"""Which of several GNSS receivers a recording means."""

from collections.abc import Mapping
from dataclasses import dataclass

SELDOM = 0.1
"""Share of usable fixes below which a receiver is of no use where another one is."""
SURER = 2.0
"""How many times smaller the stated deviation of one receiver is, so that it goes before another
with more messages. Fixes alone beside those of RTK state some fifty times as much."""


@dataclass(frozen=True, slots=True)
class ReceiverLook:
    """What the first fixes of a receiver say.

    ``usable`` is the share of them that can be used, ``sigma`` the median of their horizontal
    standard deviations in metres, NaN where none can.
    """

    usable: float
    sigma: float


def unsound_receivers(looks: Mapping[str, ReceiverLook]) -> dict[str, str]:
    """Say which receivers are worse than another one.

    Args:
        looks: What was seen of each, by topic.

    Returns:
        What is wrong, in words that follow the topic; empty where all are alike.
    """
    used = {topic: look for topic, look in looks.items() if look.usable >= SELDOM}
    if not used:
        return {}
    best = min(used, key=lambda topic: used[topic].sigma)
    reasons = {}
    for topic, look in looks.items():
        if topic not in used:
            reasons[topic] = (
                f'has {100.0 * look.usable:.0f} % usable fixes at first'
                if look.usable
                else 'has no usable fix at first'
            )
        elif look.sigma > SURER * used[best].sigma:
            reasons[topic] = (
                f'states a deviation of {look.sigma:.2g} m where {best} has '
                f'{used[best].sigma:.2g} m'
            )
    return reasons
