"""Topics that a recording lacks, or has under a type that is not read."""

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


def vendor_message(sensor: str, topic: str, kind: str, maker: str, standard: str) -> Finding:
    """A sensor is there, but no message of it is of the standard type.

    Args:
        sensor: Whose messages they are.
        topic: Where they come.
        kind: Their type.
        maker: What makes the standard type of them.
        standard: Its name.
    """
    return Finding(
        'vendor_message',
        Severity.WARNING,
        sensor,
        f'{topic} has {kind}, which is not read, and no topic has {standard}; mapped without it',
        f'{maker} makes {standard} of it: record that',
    )
