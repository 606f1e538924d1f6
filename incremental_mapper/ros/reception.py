"""One sensor's topic: received as reliably as its publishers allow, and what was lost of it."""

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import (
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.live_inputs import (
    lost_of_reliable,
    messages_held_up,
    messages_lost,
    messages_overwritten,
    nothing_comes,
    unheard_publishers,
)
from incremental_mapper.errors import ConfigError
from incremental_mapper.ros.arrivals import Arrived, HeldUp, Taken

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
OVERLAP = 1.0
"""Seconds for which the subscription before goes on beside a new one that is matched."""
PATIENCE = 10.0
"""Seconds after which it ends even where some publisher does not match the new one; and for which
what the other one has brought is known: Fast DDS sends again what was lost up to 3 s later."""
NOTHING = 5.0
"""Seconds without a message after which somebody who publishes best effort is named."""
OVERRIDABLE = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY)
"""Policies that users may always override; reliability is one more, and then settled."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Messages that were sent and never taken.

    Attributes:
        transport: Lost on the way, by the middleware's count.
        overwritten: Came, and were overwritten by newer ones before this node took them.
    """

    transport: int
    overwritten: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.transport + self.overwritten


class Reception:
    """A topic's subscriptions; used in the executor's thread only.

    There is a reliable one where all publishers offer that, else one that takes best effort. As
    long as nobody publishes there are both, so that nothing of the first messages is missed,
    whoever comes. Where the publishers change so that the other kind is due, it is made beside the
    old one, which ends when the new one is matched, and after it was emptied. What both brought
    counts once. ``qos_overrides`` of the reliability settle the question.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, depth: int, on_arrival: Callable[[], None]
    ) -> None:
        """Subscribe.

        Args:
            node: whose subscriptions they are.
            kind: class of the messages.
            topic: the name before remapping.
            depth: messages that may wait, where no override says another number.
            on_arrival: called in the executor's thread when something can be taken.

        Raises:
            ConfigError: an override cannot be used.
        """
        self.topic: str = node.resolve_topic_name(topic)
        self._node, self._kind, self._given_topic = node, kind, topic
        self._on_arrival = on_arrival
        self._depth = depth
        self._subscriptions: dict[ReliabilityPolicy, Any] = {}
        self._events: dict[ReliabilityPolicy, Any] = {}
        self._waiting: list[Taken] = []
        self._held_up = HeldUp()
        self._seen: set[tuple[int, int]] = set()
        self._doubled = False  # what both had may have been taken when one ended
        self._newest = 0
        self._missing: set[int] = set()
        self._gaps = 0
        self._gaps_before = 0
        self._lost = 0
        self._publishers: tuple[tuple[str, ReliabilityPolicy], ...] = ()
        self._heard = time.monotonic()  # or when nobody published yet
        self._hearing = False  # something has come since those who publish are known
        settled = f'qos_overrides.{self.topic}.subscription.reliability'
        self._override = settled if node.has_parameter(settled) else ''
        self._due: frozenset[ReliabilityPolicy] = frozenset()
        self._since = time.monotonic()
        self._make_due()

    @property
    def publishers(self) -> int:
        """Publishers of the topic at the last look."""
        return len(self._publishers)

    @property
    def reliability(self) -> str:
        """How it is received, in a word."""
        return 'undecided' if len(self._due) > 1 else _word(next(iter(self._due)))

    def take(self) -> list[Arrived]:
        """Take all messages that wait, each once.

        Returns:
            Them, in the order of each subscription.
        """
        found, self._waiting = self._waiting, []
        for subscription in self._subscriptions.values():
            found += self._drained(subscription)
        if not (self._overlapping or self._seen or self._doubled):
            self._held_up.take(about for _, about in found)
        taken = [
            Arrived(message, about)
            for message, about in found
            if not (self._overlapping or self._seen or self._doubled) or self._is_new(about)
        ]
        if taken:
            self._heard, self._hearing = time.monotonic(), bool(self._publishers)
        numbered = [item.about for item in taken] if self._overlapping else [it for _, it in found]
        for about in numbered:
            self._count_gap(about.get('publication_sequence_number') or 0)
        return taken

    def look(self) -> None:
        """See who publishes, and bring the subscriptions in line with that."""
        # Those of another type never match.
        wanted = f'{self._kind.__module__.split(".")[0]}/msg/{self._kind.__name__}'
        before = self._publishers
        self._publishers = tuple(
            sorted(
                (info.node_name, info.qos_profile.reliability)
                for info in self._node.get_publishers_info_by_topic(self._given_topic)
                if info.topic_type == wanted
            )
        )
        if not self._publishers:
            self._heard = time.monotonic()
        if self._publishers != before:
            self._hearing = False
        self._make_due()
        passed = time.monotonic() - self._since
        if not self._overlapping:
            if passed >= PATIENCE:
                self._doubled = False
                self._seen.clear()
                self._missing.clear()
            return
        matched = all(
            self._subscriptions[policy].get_publisher_count() >= len(self._publishers)
            for policy in self._due
        )
        if passed >= PATIENCE or (matched and passed >= OVERLAP):
            for policy in self._subscriptions.keys() - self._due:
                self._end(policy)

    def close(self) -> None:
        """Let go of what keeps the subscriptions, and with them the node, beyond their end."""
        while self._events:
            self._events.popitem()[1].destroy_when_not_in_use()

    def losses(self) -> Losses:
        """What was lost by now."""
        events = sum(self._new_events(policy) for policy in self._events)
        if self._overlapping:
            # What one of two subscriptions lost the other may have: the numbers tell.
            transport = self._lost + self._gaps - self._gaps_before
        elif not self._events:
            transport = self._lost = self._gaps
        else:
            transport = self._lost = self._lost + events
            if self.publishers != 1:
                # The numbers of several publishers have no common gaps.
                self._gaps += events
        return Losses(transport, max(self._gaps - transport, 0))

    def findings(self, sensor: str) -> list[Finding]:
        """What of it should be otherwise.

        Args:
            sensor: whose topic it is.
        """
        found, losses = [], self.losses()
        weak = [name for name, offered in self._publishers if offered != RELIABLE]
        reliable = BEST_EFFORT not in self._due
        if self._overlapping and self._publishers:
            # What one lacks the other may bring yet.
            losses = Losses(0, 0)
        if losses.transport and reliable:
            found.append(lost_of_reliable(sensor, self.topic, losses.transport))
        elif losses.transport:
            cause = messages_lost(sensor, self.topic, losses.transport, weak, self._override)
            found.append(cause)
        elif weak and not reliable and not self._hearing:
            # One that was heard, and falls silent, has nothing to say.
            silent = time.monotonic() - self._heard
            found += [nothing_comes(sensor, self.topic, weak, silent)] * (silent > NOTHING)
        if self._held_up.count and reliable:
            held_up = messages_held_up(
                sensor, self.topic, self._held_up.count, self._held_up.longest
            )
            found.append(held_up)
        if losses.overwritten:
            found.append(messages_overwritten(sensor, self.topic, losses.overwritten, self._depth))
        if reliable and weak:
            found.append(unheard_publishers(sensor, self.topic, weak, self._override))
        return found

    @property
    def _overlapping(self) -> bool:
        return len(self._subscriptions) > 1

    def _make_due(self) -> None:
        """Decide which subscriptions are due, and make those that are missing."""
        due = due_reliabilities([offered for _, offered in self._publishers])
        if self._override:
            due = frozenset([self._settled()])
        if due != self._due:
            self._due, self._since = due, time.monotonic()
        for policy in due - self._subscriptions.keys():
            self._begin(policy)

    def _settled(self) -> ReliabilityPolicy:
        """The reliability that the user asks for; raises ConfigError where it is none."""
        value = self._node.get_parameter(self._override).value
        try:
            return {'reliable': RELIABLE, 'best_effort': BEST_EFFORT}[value]
        except (KeyError, TypeError):
            raise ConfigError(
                f'parameters: {self._override} is {value!r}; it must be reliable or best_effort'
            ) from None

    def _begin(self, policy: ReliabilityPolicy) -> None:
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=self._depth, reliability=policy)
        # An event that the executor waits for costs time with every message: they are polled.
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        try:
            subscription = self._node.create_subscription(
                self._kind,
                self._given_topic,
                self._on_message,
                qos,
                event_callbacks=events,
                qos_overriding_options=QoSOverridingOptions(OVERRIDABLE),
            )
        except (AssertionError, RuntimeError, TypeError, ValueError) as error:
            # The middleware does not say which, where a value is of the wrong type.
            prefix = f'qos_overrides.{self.topic}.subscription'
            given = self._node.get_parameters_by_prefix(prefix)
            values = ', '.join(f'{name} is {item.value!r}' for name, item in given.items())
            reason = ' '.join(str(error).split()) or 'a value of the wrong type'
            raise ConfigError(
                f'parameters: {prefix} cannot be used ({values}): {reason}'
            ) from error
        if qos.depth < 1:
            raise ConfigError(
                f'parameters: qos_overrides.{self.topic}.subscription.depth is {qos.depth}; '
                'it must be at least 1'
            )
        self._depth = qos.depth
        # What was lost before is counted before there are two.
        self.losses()
        self._gaps_before = self._gaps
        self._subscriptions[policy] = subscription
        # Middleware without this event leaves the numbers of the messages.
        with suppress(UnsupportedEventTypeError):
            kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
            self._events[policy] = rclpy_implementation.EventHandle(subscription.handle, kind)

    def _end(self, policy: ReliabilityPolicy) -> None:
        """End a subscription; what waits in it is taken with the next messages."""
        left = [item for other in self._subscriptions.values() for item in self._drained(other)]
        self._waiting += left
        self._doubled = True
        self._lost = self.losses().transport
        event = self._events.pop(policy, None)
        if event is not None:
            event.destroy_when_not_in_use()
        self._node.destroy_subscription(self._subscriptions.pop(policy))
        # The other one may still bring what this one has brought.
        self._since = time.monotonic()
        if left:
            self._on_arrival()

    def _on_message(self, message: Any, about: Mapping[str, Any]) -> None:
        self._waiting.append((message, about))
        self._on_arrival()

    def _drained(self, subscription: Any) -> list[Taken]:
        """All that waits in a subscription, before the middleware overwrites it."""
        found: list[Taken] = []
        handle = subscription.handle
        with handle:
            for _ in range(self._depth):
                waiting = handle.take_message(self._kind, False)
                if waiting is None:
                    break
                found.append(waiting)
        return found

    def _is_new(self, about: Mapping[str, Any]) -> bool:
        """Whether the other subscription has not brought it yet: both have the sender's marks."""
        key = about.get('source_timestamp') or 0, about.get('publication_sequence_number') or 0
        if not all(key):
            return True
        new = key not in self._seen
        self._seen.add(key)
        return new

    def _count_gap(self, number: int) -> None:
        """Count what is missing between a message's number and the newest one before it."""
        if number in self._missing:
            # The other subscription had it, or it was sent again to the one that is left.
            self._missing.remove(number)
            self._gaps -= 1
            self._lost -= not self._overlapping
            return
        if self._overlapping and self._newest - self._depth < number <= self._newest:
            # Two subscriptions are taken one after the other.
            return
        newest, self._newest = self._newest, number
        # Several publishers count each for itself, and a new one begins anew.
        if 0 < newest < number - 1 and self._node.count_publishers(self._given_topic) == 1:
            self._gaps += number - newest - 1
            if self._overlapping:
                self._missing.update(range(max(newest + 1, number - self._depth), number))

    def _new_events(self, policy: ReliabilityPolicy) -> int:
        event = self._events[policy]
        with event:
            told = event.take_event()
        return 0 if told is None else int(told.total_count_change)


def stray_overrides(names: Iterable[str], topics: Collection[str]) -> list[str]:
    """Overrides of subscriptions that nothing goes by.

    Args:
        names: parameters below ``qos_overrides``, without that.
        topics: full names of the inputs.

    Returns:
        Those that name another topic or another policy, sorted.
    """
    policies = {*(kind.name.lower() for kind in OVERRIDABLE), 'reliability'}
    # rclpy itself subscribes to these.
    known = {'/clock', '/tf', '/tf_static'}
    found = []
    for name in names:
        topic, mark, policy = name.partition('.subscription.')
        if mark and topic not in known and not (topic in topics and policy in policies):
            found.append(f'qos_overrides.{name}')
    return sorted(found)


def due_reliabilities(offered: Sequence[ReliabilityPolicy]) -> frozenset[ReliabilityPolicy]:
    """The subscriptions that a topic should have.

    Args:
        offered: what its publishers offer.

    Returns:
        The reliable one where all offer that, the best-effort one where some do not, both where
        there is nobody yet.
    """
    if not offered:
        return frozenset([RELIABLE, BEST_EFFORT])
    return frozenset([RELIABLE if all(item == RELIABLE for item in offered) else BEST_EFFORT])


def _word(policy: ReliabilityPolicy) -> str:
    return str(policy.name).lower().replace('_', ' ')
