"""Topics that the settings name, and a recording lacks."""

from collections.abc import Sequence

from incremental_mapper.checks.finding import Finding, Severity


def missing_topic(sensor: str, key: str, topic: str, others: Sequence[str]) -> Finding:
    """The settings name a topic that is not there.

    Args:
        sensor: Whose it should be.
        key: The setting, such as ``imu.topic``.
        topic: Its value.
        others: Topics of the right type.
    """
    listed = ', '.join(sorted(others))
    remedy = f'set {key} to one of {listed}' if others else 'no topic has its type'
    return Finding(
        'missing_topic',
        Severity.WARNING,
        sensor,
        f'{key} is {topic!r}, which the recording has not; mapped without it',
        remedy,
    )
