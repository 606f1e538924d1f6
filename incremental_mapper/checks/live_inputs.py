"""What only somebody who listens can see: topics without a publisher, and foreign clouds."""

from collections.abc import Mapping, Sequence

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.frame_names import shown_frame

ROOM = (
    'with Fast DDS on one machine, give it room for whole messages: FASTRTPS_DEFAULT_PROFILES_FILE='
    "fastdds_large_clouds.xml of this package's config/ in its environment (in the node's alone it "
    'does not help)'
)
"""What helps a publisher whose packets are lost."""
RELIABLE_OR_ROOM = f'let it publish reliable: a packet that is lost is then sent again; or, {ROOM}'
"""What helps one that sends best effort."""


def nobody_publishes(
    sensor: str,
    key: str,
    topic: str,
    others: Sequence[str],
    converters: Mapping[str, str],
    standard: str,
) -> list[Finding]:
    """Nobody publishes what a sensor is expected on, and somebody what it could be.

    Args:
        sensor: Whose topic it is.
        key: The setting, such as ``imu.topic``.
        topic: Where nobody publishes.
        others: Topics of the right type that somebody publishes, and nobody here listens to.
        converters: What makes messages that are read of a vendor's, by the topic of these.
        standard: Name of the type that is read.
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
                f'{converter} makes {standard} of them',
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
        f"the clouds of {topic} are in the frame {shown_frame(frame)}, which is no LiDAR's: a map, "
        'or scans that somebody has moved already; they are used all the same',
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
        f'{count} clouds on {topic} have the frame_id {shown_frame(frame)}, between those with '
        f'{shown_frame(own)}: another LiDAR on the same topic; they are left out',
        'give each its own topic, or list one more LiDAR with this topic in lidars.names',
    )


def foreign_messages(sensor: str, own: str, frame: str, count: int) -> Finding:
    """Messages of another receiver or IMU come between those of one.

    Args:
        sensor: On whose topic they came.
        own: Its frame_id.
        frame: The other frame_id.
        count: Messages that have it.
    """
    return Finding(
        'foreign_frame',
        Severity.WARNING,
        sensor,
        f'{count} messages have the frame_id {shown_frame(frame)}, between those with '
        f'{shown_frame(own)}: another sensor on the same topic; they are left out',
        f'give each its own topic, and name the one that is wanted in {sensor}.topic',
    )


def messages_lost(
    sensor: str, topic: str, count: int, publishers: Sequence[str], override: str
) -> Finding:
    """Messages were lost on the way to a subscription that takes best effort.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        count: Messages that were lost.
        publishers: Names of the nodes that offer no more than best effort.
        override: The parameter that asks for best effort, or ''.
    """
    if override:
        why = f'because {override} says so'
        remedy = f'take {override} out, or set it to reliable'
    else:
        why = f'because {", ".join(publishers) or "a publisher"} offers no more'
        remedy = RELIABLE_OR_ROOM
    return Finding(
        'lost_messages',
        Severity.WARNING,
        sensor,
        f'{count} messages of {topic} were lost on the way: they are sent best effort, {why}',
        remedy,
    )


def nothing_comes(sensor: str, topic: str, publishers: Sequence[str], seconds: float) -> Finding:
    """Nothing comes of a topic that is published best effort: without two messages no loss shows.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        publishers: Names of the nodes that offer no more than best effort.
        seconds: For how long nothing came.
    """
    return Finding(
        'lost_messages',
        Severity.WARNING,
        sensor,
        f'no message of {topic} has come for {seconds:.0f} s, and {", ".join(publishers)} sends '
        'best effort: if it sends at all, all of it is lost on the way, as large clouds are',
        RELIABLE_OR_ROOM,
    )


def lost_of_reliable(sensor: str, topic: str, count: int) -> Finding:
    """Messages were lost on the way though they are sent reliably.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        count: Messages that were lost.
    """
    return Finding(
        'lost_messages',
        Severity.WARNING,
        sensor,
        f'{count} messages of {topic} were lost on the way: their publisher gave them up before '
        'they were through',
        f'{ROOM}; else a greater depth in the QoS of the publisher, or less to send',
    )


def messages_held_up(sensor: str, topic: str, count: int, longest: float) -> Finding:
    """Messages that were sent one after the other came at once, as behind one that was lost.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        count: How often that was long.
        longest: For how many seconds the first of them was held up.
    """
    return Finding(
        'messages_held_up',
        Severity.WARNING,
        sensor,
        f'{count} times messages of {topic} that were sent one after the other came at once, the '
        f'first of them {longest:.1f} s late: one was lost on the way and sent again, or the '
        'machine is too busy; the map waited',
        ROOM,
    )


def messages_overwritten(sensor: str, topic: str, count: int, depth: int) -> Finding:
    """Messages came and were overwritten before the node took them.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        count: Messages that were overwritten.
        depth: How many may wait.
    """
    key = f'qos_overrides.{topic}.subscription.depth'
    return Finding(
        'overwritten_messages',
        Severity.WARNING,
        sensor,
        f'{count} messages of {topic} came and were overwritten before they were taken: the '
        f'machine is too busy, and more than {depth} waited',
        f'leave the node more of the machine, or set {key} above {depth}',
    )


def unheard_publishers(
    sensor: str, topic: str, publishers: Sequence[str], override: str
) -> Finding:
    """Nothing is heard of publishers, since they offer less than is asked for.

    Args:
        sensor: Whose topic it is.
        topic: Its name.
        publishers: Names of their nodes.
        override: The parameter that asks for it.
    """
    return Finding(
        'unheard_publisher',
        Severity.WARNING,
        sensor,
        f'nothing is heard of {", ".join(publishers)} on {topic}: best effort is offered, and '
        f'{override} asks for reliable',
        f'take {override} out, or let it publish reliable',
    )


def second_mapper(topic: str) -> Finding:
    """Another node publishes the same as this one.

    Args:
        topic: A topic of both.
    """
    return Finding(
        'second_mapper',
        Severity.WARNING,
        '',
        f'another node publishes on {topic}: whoever listens gets the poses of two maps in turn, '
        'and a service is answered by either',
        'end one of them, or give each its own name or namespace (-r __node:=..., -r __ns:=...)',
    )


def shared_frame(topic: str, edge: tuple[str, str], parent: str, both: bool) -> Finding:
    """Another program tells where a frame is that this node tells of.

    Args:
        topic: Where it does.
        edge: Its parent and child.
        parent: The parent by this node.
        both: Whether this node broadcasts odom to base, too.
    """
    other, child = edge
    alone = 'tf.publish: map_to_odom where the robot has odometry of its own, or ' * both
    return Finding(
        'shared_frame',
        Severity.WARNING,
        child,
        f'another program tells on {topic} where {shown_frame(child)} is in {shown_frame(other)}, '
        f'and this node where it is in {shown_frame(parent)}: a frame has one parent, and whoever '
        'asks gets the one and the other in turn',
        f'set {alone}tf.publish: none; or give this node frames of its own, as each of several '
        'robots needs (frames.map, frames.odom, frames.base)',
    )
