"""What only somebody who listens can see: topics without a publisher, and foreign clouds."""

from collections.abc import Mapping, Sequence

from incremental_mapper.checks.finding import Finding, Severity


def nobody_publishes(
    sensor: str, key: str, topic: str, others: Sequence[str], converters: Mapping[str, str]
) -> list[Finding]:
    """Nobody publishes what a sensor is expected on, and somebody what it could be.

    Args:
        sensor: Whose topic it is.
        key: The setting, such as ``imu.topic``.
        topic: Where nobody publishes.
        others: Topics of the right type that somebody publishes, and nobody here listens to.
        converters: What makes clouds of a vendor's messages that are published, by their topic.
    """
    found = []
    if others:
        found.append(
            Finding(
                'missing_topic',
                Severity.WARNING,
                sensor,
                f'nobody publishes on {topic}; on {", ".join(others)} somebody does',
                f'set {key} if that is it, such as -p {key}:={others[0]}',
            )
        )
    for name, converter in converters.items():
        found.append(
            Finding(
                'vendor_message',
                Severity.WARNING,
                sensor,
                f"nobody publishes on {topic}; {name} has a vendor's own messages, which are not "
                'read',
                f'{converter} makes PointCloud2 of them',
            )
        )
    return found


def other_type(sensor: str, topic: str, types: Sequence[str], wanted: str) -> Finding:
    """A topic has messages of another type than the sensor's.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        types: What is published there.
        wanted: What is listened to.
    """
    return Finding(
        'other_type',
        Severity.WARNING,
        sensor,
        f'{topic} is published as {", ".join(types)}, and not as {wanted}: nothing of it is heard',
        'name the topic that has that type, or start the driver that publishes it',
    )


def map_frame(lidar: str, key: str, topic: str, frame: str) -> Finding:
    """Clouds are in a frame that stands still: a map, or scans that somebody has moved.

    Args:
        lidar: Whose they should be.
        key: The setting that names the topic.
        topic: Where they come.
        frame: Their frame_id.
    """
    return Finding(
        'map_frame',
        Severity.WARNING,
        lidar,
        f"the clouds of {topic} are in the frame {frame!r}, which is no LiDAR's: a map, or scans "
        'that somebody has moved already; they are used all the same',
        f"set {key} to the topic of the LiDAR's driver",
    )


def foreign_frame(lidar: str, topic: str, own: str, frame: str, count: int) -> Finding:
    """Clouds of another LiDAR come between those of one.

    Args:
        lidar: Whose topic it is.
        topic: Its name.
        own: The frame_id of its clouds.
        frame: The other frame_id.
        count: Clouds that have it.
    """
    return Finding(
        'foreign_frame',
        Severity.WARNING,
        lidar,
        f'{count} clouds on {topic} have the frame_id {frame!r}, between those with {own!r}: '
        'another LiDAR on the same topic; they are left out',
        'give each its own topic, or list one more LiDAR with this topic in lidars.names',
    )
