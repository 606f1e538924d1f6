"""Which reliability a topic is received with, what a change of it loses (nothing), and losses."""

import time
from itertools import count

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from ros_helpers import next_domain
from sensor_msgs.msg import NavSatFix

from incremental_mapper.errors import ConfigError
from incremental_mapper.ros import reception
from incremental_mapper.ros.arrivals import HeldUp
from incremental_mapper.ros.reception import (
    BEST_EFFORT,
    RELIABLE,
    Reception,
    due_reliabilities,
    stray_overrides,
)

DEPTH = 50
OVERRIDES = 'qos_overrides./fix.subscription.'


class Listening:
    """A reception whose executor runs when it is told to, and publishers for it."""

    def __init__(self, **overrides):
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=next_domain(),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node(
            'listening',
            context=self.context,
            parameter_overrides=[Parameter(OVERRIDES + k, value=v) for k, v in overrides.items()],
            automatically_declare_parameters_from_overrides=True,
        )
        self.numbers = []
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._sent = count()
        try:
            self.reception = Reception(self.node, NavSatFix, 'fix', DEPTH, self._take)
        except ConfigError:
            self.close()
            raise

    def _take(self):
        self.numbers += [int(arrived.message.latitude) for arrived in self.reception.take()]

    def publisher(self, reliability, depth=1000):
        profile = QoSProfile(depth=depth, reliability=reliability)
        return self.node.create_publisher(NavSatFix, 'fix', profile)

    def send(self, publisher):
        number = next(self._sent)
        publisher.publish(NavSatFix(latitude=float(number)))
        return number

    def spin(self, seconds=0.0):
        end = time.monotonic() + seconds
        while True:
            for _ in range(20):
                self.executor.spin_once(0.0)
            self.reception.look()
            if time.monotonic() >= end:
                return
            time.sleep(0.002)

    def send_until(self, publisher, condition, timeout=4.0):
        """Send without a pause until something holds; returns the numbers."""
        sent, end = [], time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, 'timed out'
            sent.append(self.send(publisher))
            self.spin(0.002)
        return sent

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def listen():
    made = []

    def make(**overrides):
        made.append(Listening(**overrides))
        return made[-1]

    yield make
    for item in made:
        item.close()


def matched(publisher, subscriptions):
    return lambda: publisher.get_subscription_count() == subscriptions


def found_by(listening, publisher):
    """Both subscriptions match the publisher before it says a word."""
    end = time.monotonic() + 4.0
    while not matched(publisher, 2)():
        assert time.monotonic() < end
        time.sleep(0.01)
    return publisher


@pytest.mark.parametrize(
    ('offered', 'due'),
    [
        ([], {RELIABLE, BEST_EFFORT}),
        ([RELIABLE], {RELIABLE}),
        ([RELIABLE, RELIABLE], {RELIABLE}),
        ([BEST_EFFORT], {BEST_EFFORT}),
        ([RELIABLE, BEST_EFFORT], {BEST_EFFORT}),
        ([RELIABLE, ReliabilityPolicy.UNKNOWN], {BEST_EFFORT}),
    ],
)
def test_reliable_where_all_publishers_offer_it(offered, due):
    assert due_reliabilities(offered) == due


def test_overrides_that_nothing_goes_by_are_told():
    names = [
        '/fix.subscription.depth',
        '/fix.subscription.reliability',
        '/tf.subscription.depth',
        '/map.publisher.depth',
        '/fax.subscription.depth',
        '/fix.subscription.deadline',
    ]
    assert stray_overrides(names, {'/fix'}) == [
        'qos_overrides./fax.subscription.depth',
        'qos_overrides./fix.subscription.deadline',
    ]


def test_changes_of_the_publishers_lose_nothing_and_double_nothing(listen):
    listening = listen()
    reception = listening.reception
    assert reception.reliability == 'undecided'
    reliable = found_by(listening, listening.publisher(RELIABLE))
    sent = listening.send_until(reliable, matched(reliable, 1))
    assert reception.reliability == 'reliable'
    weak = listening.publisher(BEST_EFFORT)
    # The reliable subscription does not match the second publisher: one that does replaces it.
    sent += listening.send_until(reliable, matched(weak, 1))
    sent += [listening.send(weak), listening.send(reliable)]
    sent += listening.send_until(reliable, lambda: list(reception._subscriptions) == [BEST_EFFORT])
    assert reception.reliability == 'best effort'
    listening.node.destroy_publisher(weak)
    sent += listening.send_until(reliable, lambda: list(reception._subscriptions) == [RELIABLE])
    listening.spin(0.1)
    assert reception.reliability == 'reliable'
    # Each once; where there are two subscriptions, the times of receipt put them in order.
    assert sorted(listening.numbers) == sent
    assert reception.losses().total == 0 and reception.findings('gnss') == []


def test_the_first_messages_of_a_best_effort_publisher_are_heard(listen):
    listening = listen()
    weak = listening.publisher(BEST_EFFORT)
    end = time.monotonic() + 4.0
    while not matched(weak, 1)():
        assert time.monotonic() < end
        time.sleep(0.01)
    # Before anybody has looked who publishes.
    sent = [listening.send(weak) for _ in range(5)]
    sent += listening.send_until(weak, lambda: len(listening.reception._subscriptions) == 1)
    listening.spin(0.1)
    assert sorted(listening.numbers) == sent
    assert listening.reception.reliability == 'best effort'


def test_somebody_who_publishes_best_effort_and_is_not_heard_is_named(listen, monkeypatch):
    monkeypatch.setattr(reception, 'NOTHING', -1.0)
    listening = listen()
    listening.spin()
    assert listening.reception.findings('gnss') == []  # nobody is there
    weak = listening.publisher(BEST_EFFORT)
    end = time.monotonic() + 4.0
    while not listening.reception.publishers:
        assert time.monotonic() < end
        listening.spin(0.01)
    (finding,) = listening.reception.findings('gnss')
    assert finding.rule == 'lost_messages' and 'listening sends best effort' in finding.text
    assert 'fastdds_large_clouds.xml' in finding.remedy
    monkeypatch.setattr(reception, 'NOTHING', 60.0)
    listening.send_until(weak, matched(weak, 1))
    assert listening.reception.findings('gnss') == []
    heard = len(listening.numbers)
    listening.send_until(weak, lambda: len(listening.numbers) > heard)
    monkeypatch.setattr(reception, 'NOTHING', -1.0)
    assert listening.reception.findings('gnss') == []  # it was heard, and has nothing to say


def test_a_first_message_that_both_subscriptions_hold_when_one_of_them_ends_comes_once(
    listen, monkeypatch
):
    listening = listen()
    publisher = found_by(listening, listening.publisher(RELIABLE))
    listening.reception.look()
    number = listening.send(publisher)
    time.sleep(0.2)  # it waits in both, and nobody has taken it
    monkeypatch.setattr(reception, 'OVERLAP', 0.0)
    listening.reception.look()
    assert len(listening.reception._subscriptions) == 1
    listening.spin(0.1)
    assert listening.numbers == [number]


def test_messages_that_were_overwritten_are_counted_with_the_remedy(listen):
    listening = listen(depth=20)
    publisher = found_by(listening, listening.publisher(RELIABLE))
    listening.send_until(publisher, matched(publisher, 1))
    before = len(listening.numbers)
    for _ in range(70):
        listening.send(publisher)
    time.sleep(0.1)
    listening.spin()
    assert len(listening.numbers) - before == 20
    losses = listening.reception.losses()
    assert (losses.transport, losses.overwritten) == (0, 50)
    (finding,) = listening.reception.findings('gnss')
    assert finding.rule == 'overwritten_messages'
    assert '50 messages of /fix' in finding.text
    assert f'{OVERRIDES}depth above 20' in finding.remedy


def test_an_override_settles_the_reliability(listen):
    listening = listen(reliability='reliable')
    weak = listening.publisher(BEST_EFFORT)
    listening.spin(0.3)
    assert listening.reception.reliability == 'reliable'
    assert weak.get_subscription_count() == 0
    (finding,) = listening.reception.findings('gnss')
    assert finding.rule == 'unheard_publisher'
    assert 'listening' in finding.text and f'{OVERRIDES}reliability' in finding.remedy
    other = listen(reliability='best_effort')
    other.publisher(RELIABLE)
    other.spin(0.3)
    assert other.reception.reliability == 'best effort'


@pytest.mark.parametrize(
    ('policy', 'value'),
    [
        ('reliability', 'perhaps'),
        ('reliability', 1),
        pytest.param('depth', 0, marks=pytest.mark.filterwarnings('ignore:A zero depth')),
        ('depth', 'deep'),
        ('history', 'all'),
        ('durability', 'no'),
    ],
)
def test_overrides_that_cannot_be_used_are_refused(listen, policy, value):
    with pytest.raises(ConfigError, match=r'/fix\.subscription'):
        listen(**{policy: value})


def test_two_subscriptions_that_bring_messages_in_turn_have_lost_none(listen):
    """One brings the first messages later than the other brought one after them."""
    listening = listen()
    reception = listening.reception
    found_by(listening, listening.publisher(RELIABLE))
    for number in (7, 5, 6, 8, 11, 9, 10, 12):
        reception._count_gap(number)
    assert reception.losses().total == 0


def brought(reception, moments):
    """Take messages as the middleware gives them: when each was received, s, by its number."""
    reception._waiting = [
        (
            NavSatFix(),
            {
                'received_timestamp': int(moment * 1e9),
                'source_timestamp': number,
                'publication_sequence_number': number,
            },
        )
        for number, moment in moments.items()
    ]
    return reception.take()


def test_messages_that_come_at_once_behind_one_that_was_sent_again_are_told(listen):
    """Fast DDS sends again what was lost up to 3 s later, and gives the rest with it."""
    listening = listen(reliability='reliable')
    held_up = listening.reception._held_up
    second = 1_000_000_000
    ways = [(k, k + 1) for k in range(100)]  # in time, by a clock that is 1 ns behind
    ways += [(second + k * second // 100, 3 * second + k) for k in range(190)]
    held_up.take({'source_timestamp': sent, 'received_timestamp': got} for sent, got in ways[1:])
    (finding,) = listening.reception.findings('gnss')
    assert finding.rule == 'messages_held_up'
    assert '1 times messages of /fix' in finding.text and '1.9 s late' in finding.text
    assert 'fastdds_large_clouds.xml' in finding.remedy


def test_messages_that_come_as_they_were_sent_are_not_held_up():
    held_up, ms = HeldUp(), 1_000_000
    held_up.take(
        # Sometimes 0.05 s late, and 0.4 s after a pause of the whole machine.
        {'source_timestamp': sent * ms, 'received_timestamp': (sent + late) * ms}
        for sent, late in ((10, 5), (20, 55), (30, 45), (40, 35), (1000, 400), (1100, 400))
    )
    held_up.take([{}])  # middleware that knows nothing
    assert held_up.count == 0


def test_what_is_sent_again_after_a_change_of_subscriptions_is_neither_lost_nor_double(listen):
    """Best effort brought what came behind it, and has ended by then."""
    listening = listen()
    reception = listening.reception
    found_by(listening, listening.publisher(RELIABLE))
    brought(reception, {number: 10.0 for number in (1, 2, 3, 4, 5, 9, 10, 11, 12)})
    assert reception.losses().total == 3  # of one that is best effort it would be so
    reception._end(BEST_EFFORT)
    time.sleep(1.5)
    reception.look()
    taken = brought(reception, {number: 12.0 for number in range(6, 14)})
    assert [item.about['publication_sequence_number'] for item in taken] == [6, 7, 8, 13]
    assert reception.losses().total == 0
