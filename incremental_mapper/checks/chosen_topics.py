"""Topics that a recording lacks, has under a type that is not read, or has several of."""

from collections.abc import Mapping, Sequence

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


def one_of_several(
    sensor: str, kind: str, taken: str, reasons: Mapping[str, str], count: int
) -> Finding:
    """Of several topics that could be a sensor's one was taken, since others are worse.

    Args:
        sensor: ``imu`` or ``gnss``.
        kind: What there are several of, in words.
        taken: The topic.
        reasons: What is wrong with others, in words that follow the topic.
        count: How many there are.
    """
    why = ', '.join(f'{topic} {reason}' for topic, reason in reasons.items())
    return Finding(
        'imu_topic' if sensor == 'imu' else 'gnss_topic',
        Severity.MENDED,
        sensor,
        f'of {count} {kind} {taken} is taken: {why}',
        f'{sensor}.topic: {taken} spares the look, another one is taken if it is named',
    )
