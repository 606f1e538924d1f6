"""Playing a bag: its serialised messages on ROS topics, at the pace at which they were logged."""

import importlib
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from incremental_mapper.datasets.bag_files import describe_topics
from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.ros.player.pace import Pace
from incremental_mapper.ros.player.read_ahead import read_ahead
from incremental_mapper.ros.player.recording import RecordedTopic, Recording
from incremental_mapper.ros.player.subscribers import Subscribers

NODE_NAME = 'incremental_mapper_player'
CLOCK_TOPIC = '/clock'

_CLOCK_PERIOD = 0.01
"""Seconds between two messages on /clock."""
_LOOK = 0.05
"""Seconds between two looks at the keyboard."""
_ROUND_GAP = 0.1
"""Seconds between two rounds of a loop; keeps a bag of one message from flooding."""
_AHEAD = 50
"""Messages that are read before they are due."""
_STUCK = 30.0
"""Seconds without room for one message; DDS forgets a dead subscriber after 20."""
_ACKNOWLEDGED = 10.0
"""Seconds that the subscribers have to acknowledge the last messages."""
_INTERRUPTIBLE = 0.2
"""Seconds for which a call of the middleware may keep Ctrl-C waiting."""


@dataclass(frozen=True, slots=True)
class PlayOptions:
    """What to play and how.

    Attributes:
        rate: seconds of the bag that are played in a second.
        loop: play again and again.
        start: seconds at the beginning of the bag that are left out.
        duration: seconds of the bag that are played from there; None plays to its end.
        topics: names of those that are played; none means all.
        clock: publish the bag's time on /clock.
        wait: seconds that subscribers have to be found.
    """

    rate: float = 1.0
    loop: bool = False
    start: float = 0.0
    duration: float | None = None
    topics: tuple[str, ...] = ()
    clock: bool = False
    wait: float = 60.0


class Controls(Protocol):
    """Whoever runs the player: a terminal, a test."""

    def wait(self, seconds: float) -> bool:
        """Wait that long; returns True at once when the user wants to pause or to go on."""
        ...

    def show(self, done: float, total: float, paused: bool) -> None:
        """Take note of how much of this round was played, in seconds of the bag."""
        ...


@dataclass(slots=True)
class PlayReport:
    """What was played so far: rounds that were begun, messages, seconds that they were late.

    ``unreadable`` messages could not be converted; ``missing`` ones the bag announces but lost.
    """

    rounds: int = 0
    messages: int = 0
    late_sum: float = 0.0
    late_most: float = 0.0
    unreadable: int = 0
    missing: int = 0

    def __str__(self) -> str:
        parts = [f'{self.messages} messages' + f' in {self.rounds} rounds' * (self.rounds > 1)]
        if self.messages:
            mean = 1e3 * self.late_sum / self.messages
            parts.append(f'on average {mean:.1f} ms late, at most {1e3 * self.late_most:.1f} ms')
        if self.unreadable:
            parts.append(f'{self.unreadable} unreadable')
        if self.missing:
            parts.append(f'{self.missing} more announced but missing')
        return '; '.join(parts)


@contextmanager
def open_player(path: Path, options: PlayOptions, controls: Controls) -> Iterator['Player']:
    """Make a player with a node of its own in a context of its own.

    Args:
        path: a bag, see ``datasets.bag_files``.
        options: what to play and how.
        controls: whoever may pause and wants to know how far it is.

    Yields:
        The player, whose topics are offered.

    Raises:
        InputError: the bag cannot be read or has nothing to play, or ROS cannot start.
    """
    with Recording(path) as recording:
        context = Context()
        try:
            # Ctrl-C stays Python's: rclpy's handler would pull the context from under a publisher.
            rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
            node = rclpy.create_node(
                NODE_NAME, context=context, enable_rosout=False, start_parameter_services=False
            )
        except RuntimeError as error:
            context.try_shutdown()
            reason = ' '.join(str(error).split())
            raise InputError(f'ROS cannot be started ({reason})') from error
        try:
            yield Player(recording, node, options, controls)
        finally:
            node.destroy_node()
            context.try_shutdown()


class Player:
    """Publishes the messages of one recording.

    ``notes`` are remarks on what is not played, and why; ``report`` is what was played so far.
    """

    def __init__(
        self, recording: Recording, node: Node, options: PlayOptions, controls: Controls
    ) -> None:
        """Offer the topics; raises InputError where there is nothing to play."""
        self.notes: list[str] = list(recording.notes)
        self.report = PlayReport()
        self._recording = recording
        self._options = options
        self._controls = controls
        self._start = recording.start + round(options.start * NANOSECONDS)
        self._stop = recording.end
        if options.duration is not None:
            self._stop = min(self._stop, self._start + round(options.duration * NANOSECONDS))
        self._publishers: dict[str, Any] = {}
        self._announced = 0
        for topic in self._wanted():
            publisher = self._offer(node, topic)
            if publisher is not None:
                self._publishers[topic.name] = publisher
                self._announced += topic.count
        if not self._publishers:
            reasons = '; '.join(self.notes) or describe_topics(recording.topics)
            raise InputError(f'{recording.path}: has nothing to play. {reasons}')
        types = {topic.name: topic.type for topic in recording.topics}
        self._subscribers = Subscribers(node, self._publishers, types)
        self._first = self._first_stamp()
        self._clock = _Clock(node) if options.clock else None

    def wait_for_subscriptions(self, tell: Callable[[str], object] = lambda text: None) -> bool:
        """Wait until those who are to hear it have subscribed; see ``Subscribers.wait``.

        Args:
            tell: Is told what is waited for, if it takes long.

        Returns:
            False where nobody has subscribed.
        """
        return self._subscribers.wait(self._options.wait, self._controls.wait, tell)

    def play(self) -> None:
        """Play once, or again and again; raises InputError where the bag is damaged."""
        while True:
            self.report.rounds += 1
            self._play_round()
            if not self._options.loop:
                return

    def wait_for_acknowledgement(self) -> bool:
        """Wait until all subscribers have everything; False where they do not in time."""
        end = time.monotonic() + _ACKNOWLEDGED
        waiting = list(self._publishers.values())
        while waiting and time.monotonic() < end:
            if waiting[-1].wait_for_all_acked(Duration(seconds=_INTERRUPTIBLE)):
                waiting.pop()
        return not waiting

    def _wanted(self) -> list[RecordedTopic]:
        """The topics that the user wants and that have messages."""
        topics = self._recording.topics
        # ROS 1 bags have relative names too.
        names = {name.lstrip('/') for name in self._options.topics}
        unknown = names - {topic.name.lstrip('/') for topic in topics}
        if unknown:
            raise InputError(
                f'{self._recording.path}: has no topic {", ".join(sorted(unknown))}. '
                + describe_topics(topics)
            )
        return [t for t in topics if t.count and (not names or t.name.lstrip('/') in names)]

    def _offer(self, node: Node, topic: RecordedTopic) -> Any:
        """A publisher for the topic, or None with a note."""
        if self._options.clock and topic.name == CLOCK_TOPIC:
            self.notes.append(f'{topic.name}: not from the bag, --clock publishes it')
            return None
        message_class = _message_class(topic.type)
        if message_class is None:
            self.notes.append(f'{topic.name}: {topic.type} is not installed')
            return None
        try:
            return node.create_publisher(message_class, topic.name, _quality(topic))
        except InvalidTopicNameException:
            self.notes.append(f'{topic.name}: is no valid name in ROS 2')
            return None

    def _first_stamp(self) -> int:
        for _, stamp, _ in self._messages(self._recording):
            return stamp
        raise InputError(
            f'{self._recording.path}: has no message to play between '
            f'{(self._start - self._recording.start) / NANOSECONDS:g} s and '
            f'{(self._stop - self._recording.start) / NANOSECONDS:g} s of the bag'
        )

    def _messages(self, recording: Recording) -> Iterator[tuple[str, int, bytes | None]]:
        return recording.messages(self._publishers, self._start, self._stop)

    def _read(self) -> Iterator[tuple[str, int, bytes | None]]:
        """The messages, from a reader of their own: SQLite ties a reader to its thread."""
        with Recording(self._recording.path) as recording:
            yield from self._messages(recording)

    def _play_round(self) -> None:
        report = self.report
        found = 0
        # A short break comes before every round but the first.
        lead = _ROUND_GAP * self._options.rate if report.rounds > 1 else 0.0
        pace = None
        # Bags are read in chunks, which take tens of milliseconds.
        with closing(read_ahead(self._read, _AHEAD)) as messages:
            for name, stamp, data in messages:
                # Time starts to run when the first message has been read.
                pace = pace or Pace(self._options.rate, self._first - round(lead * NANOSECONDS))
                found += 1
                if data is None:
                    report.unreadable += 1
                    continue
                self._wait(pace, stamp)
                late = -pace.left(stamp)
                self._publish(name, data)
                report.messages += 1
                report.late_sum += late
                report.late_most = max(report.late_most, late)
        if self._start <= self._recording.start and self._stop == self._recording.end:
            report.missing += self._announced - found

    def _wait(self, pace: Pace, stamp: int) -> None:
        """Wait until ``stamp`` is due; obeys the user and keeps /clock going meanwhile."""
        longest = _LOOK if self._clock is None else _CLOCK_PERIOD
        while True:
            if self._controls.wait(min(max(pace.left(stamp), 0.0), longest)):
                pace.toggle()
            now = pace.stamp()
            if self._clock is not None:
                self._clock.tick(now)
            self._controls.show(
                min(now - self._first, stamp - self._first) / NANOSECONDS,
                (self._stop - self._first) / NANOSECONDS,
                pace.paused,
            )
            if pace.left(stamp) <= 0.0:
                return

    def _publish(self, name: str, data: bytes) -> None:
        """Publish; waits while the slowest subscriber leaves no room, so that nothing is lost."""
        publisher = self._publishers[name]
        end = time.monotonic() + _STUCK
        while True:
            try:
                publisher.publish(data)
                return
            # The middleware gives up after 100 ms without room.
            except RuntimeError as error:
                if time.monotonic() > end:
                    reason = ' '.join(str(error).split())
                    raise InputError(
                        f'{name}: no message could be published for {_STUCK:g} s ({reason}); '
                        'stop the subscriber that hangs'
                    ) from error


class _Clock:
    """Publishes the bag's time."""

    def __init__(self, node: Node) -> None:
        self._message = Clock()
        self._publisher = node.create_publisher(Clock, CLOCK_TOPIC, 10)
        self._next = 0.0

    def tick(self, stamp: int) -> None:
        """Publish ``stamp`` (ns) if it is time to."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + _CLOCK_PERIOD
            self._message.clock.sec, self._message.clock.nanosec = divmod(stamp, NANOSECONDS)
            self._publisher.publish(self._message)


def _message_class(name: str) -> Any:
    """The class of a type like ``std_msgs/msg/String``, or None where it is not installed."""
    parts = name.split('/')
    if len(parts) != 3 or parts[1] != 'msg':
        return None
    try:
        return getattr(importlib.import_module(f'{parts[0]}.msg'), parts[2])
    except (ImportError, AttributeError):
        return None


def _quality(topic: RecordedTopic) -> QoSProfile:
    """Reliable, which serves best-effort subscriptions too; late joiners get what they got then.

    Where nothing is for late joiners, everything is kept until it is acknowledged: the middleware
    then makes the player wait rather than overwrite.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST if topic.kept else HistoryPolicy.KEEP_ALL,
        depth=topic.kept,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.kept else DurabilityPolicy.VOLATILE,
    )
