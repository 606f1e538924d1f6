"""Places of sensors by transforms that come while measurements wait: real trees, no middleware."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from incremental_mapper.measurements import make_imu, make_scan
from incremental_mapper.ros import live_extrinsics
from incremental_mapper.ros.inbox import Renewal
from incremental_mapper.ros.live_extrinsics import LiveExtrinsics
from incremental_mapper.settings import make_config

CONFIG = make_config({'lidars': {'names': ['left', 'right']}})
GIVEN = {'T_base_sensor': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]}
GIVEN_REST = {'imu': GIVEN, 'gnss': GIVEN}
LEFT, RIGHT = (1.0, 0.5, 2.0), (1.0, -0.5, 2.0)


def transforms(*edges):
    """A ``tf2_msgs/TFMessage`` of (parent, child, x, y, z)."""
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(frame_id=parent),
                child_frame_id=child,
                transform=SimpleNamespace(
                    translation=SimpleNamespace(x=x, y=y, z=z),
                    rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
                ),
            )
            for parent, child, x, y, z in edges
        ]
    )


BOTH = transforms(('base_link', 'velo_left', *LEFT), ('base_link', 'velo_right', *RIGHT))


class Run:
    """Extrinsics under test with everything that they handed on and told."""

    def __init__(self, settings, waiting=True, config=CONFIG):
        self.handed_on, self.told = [], []
        self.extrinsics = LiveExtrinsics(
            settings, config, self.handed_on.append, self.told.append, waiting
        )

    def send(self, *sensors):
        for sensor in sensors:
            if sensor in CONFIG.lidars:
                scan = make_scan(len(self.handed_on) + 1, sensor, np.ones((5, 3)))
                self.extrinsics.take(scan, f'velo_{sensor}')
            else:
                sample = make_imu(len(self.handed_on) + 1, sensor, np.zeros(3), np.ones(3))
                self.extrinsics.take(sample, sensor)

    def send_from(self, lidar, frame):
        """A cloud of a LiDAR with another frame_id."""
        scan = make_scan(len(self.handed_on) + 1, lidar, np.ones((5, 3)))
        self.extrinsics.take(scan, frame)

    @property
    def sensors(self):
        return [item.sensor for item in self.handed_on if not isinstance(item, Renewal)]

    @property
    def renewals(self):
        return [item for item in self.handed_on if isinstance(item, Renewal)]


@pytest.fixture
def patience(monkeypatch):
    """Set how long measurements wait."""

    def wait(seconds, for_lidars=None):
        monkeypatch.setattr(live_extrinsics, 'PATIENCE', seconds)
        for_lidars = seconds if for_lidars is None else for_lidars
        monkeypatch.setattr(live_extrinsics, 'LONG_PATIENCE', for_lidars)

    return wait


def test_measurements_wait_for_transforms_and_come_after_them_in_order():
    run = Run(GIVEN_REST)
    run.send('left', 'imu', 'right', 'gnss')
    assert run.handed_on == []
    run.extrinsics.static(BOTH)
    assert isinstance(run.handed_on[0], Renewal)
    assert run.sensors == ['left', 'imu', 'right', 'gnss']
    lidars = run.renewals[0].settings['lidars']
    assert tuple(lidars['left']['T_base_sensor'][:3]) == LEFT
    assert tuple(lidars['right']['T_base_sensor'][:3]) == RIGHT
    assert [note.split(':')[0] for note in run.told] == [
        'lidars.left.T_base_sensor',
        'lidars.right.T_base_sensor',
    ]
    assert all('/tf_static' in note for note in run.told)


def test_transforms_that_are_there_already_hold_nothing_back_once_all_have_sent():
    run = Run(GIVEN_REST)
    run.extrinsics.static(BOTH)
    run.send('left', 'imu', 'right', 'gnss', 'imu')
    assert run.sensors == ['left', 'imu', 'right', 'gnss', 'imu'] and len(run.renewals) == 1


def test_without_transforms_the_wait_is_bounded_and_it_is_said(patience):
    patience(0.0)
    run = Run(GIVEN_REST)
    run.send('left', 'right', 'imu')
    assert run.sensors == ['left', 'imu'] and run.renewals == []
    assert run.extrinsics.drops == {('right', 'unplaced'): 1}
    rules = {finding.rule for finding in run.extrinsics.findings}
    assert rules == {'lidar_left_out', 'identity_extrinsics'}


def test_a_lidar_that_would_be_left_out_is_waited_for_longer(patience):
    run, placed = Run(GIVEN_REST), Run({**GIVEN_REST, 'lidars': {'left': GIVEN, 'right': GIVEN}})
    for one in (run, placed):
        one.send('left', 'imu', 'right')
    patience(0.0, for_lidars=60.0)
    for one in (run, placed):
        one.extrinsics.look()
    assert run.handed_on == [] and placed.sensors == ['left', 'imu', 'right']
    run.extrinsics.static(BOTH)
    run.send('gnss')
    assert run.sensors == ['left', 'imu', 'right', 'gnss'] and len(run.renewals) == 1


def test_transforms_that_come_late_begin_anew_and_the_finding_goes(patience):
    patience(0.0)
    run = Run(GIVEN_REST)
    run.send('left', 'right', 'imu', 'gnss')
    run.extrinsics.static(BOTH)
    (late,) = run.renewals
    assert run.handed_on[-1] is late and 'left, right' in late.reason
    assert run.extrinsics.findings == ()


def test_places_of_the_parameters_win_and_a_difference_is_said(patience):
    patience(0.0)
    lidars = {'left': GIVEN, 'right': {'T_base_sensor': [*RIGHT, 0.0, 0.0, 0.0, 1.0]}}
    run = Run({**GIVEN_REST, 'lidars': lidars}, waiting=False)
    run.extrinsics.static(BOTH)
    run.send('left', 'right', 'imu')
    assert run.renewals == [] and run.sensors == ['left', 'right', 'imu']
    assert [finding.rule for finding in run.extrinsics.findings] == ['extrinsics_differ']


def test_transforms_that_stand_still_on_tf_are_used_and_those_that_move_are_not():
    run = Run(GIVEN_REST)
    run.send('left', 'imu', 'right', 'gnss')
    for step in range(3):
        moved = float(step)
        run.extrinsics.moving(
            transforms(
                ('odom', 'base_link', moved, 0.0, 0.0),
                ('base_link', 'velo_left', *LEFT),
                ('base_link', 'velo_right', *RIGHT),
            )
        )
    assert len(run.renewals) == 1
    assert tuple(run.renewals[0].settings['lidars']['left']['T_base_sensor'][:3]) == LEFT
    assert all(note.startswith('lidars.') and ' /tf,' in note for note in run.told)


def test_a_chain_of_transforms_is_followed_and_a_broken_one_is_said(patience):
    patience(0.0)
    run = Run({**GIVEN_REST, 'lidars': {'right': GIVEN}})
    chain = transforms(('base_link', 'roof', 0.0, 0.0, 1.0), ('roof', 'velo_left', 1.0, 0.5, 1.0))
    chain.transforms[0].transform.rotation.w = 0.0
    run.extrinsics.static(chain)
    run.send('left', 'right', 'imu', 'gnss')
    rules = {finding.rule for finding in run.extrinsics.findings}
    assert 'bad_transform' in rules and run.renewals == []
    chain.transforms[0].transform.rotation.w = 1.0
    run.extrinsics.static(chain)
    assert tuple(run.renewals[0].settings['lidars']['left']['T_base_sensor'][:3]) == LEFT


def test_a_lidar_that_nobody_places_beside_another_is_left_out_and_counted(patience):
    patience(0.0)
    run = Run({**GIVEN_REST, 'lidars': {'left': GIVEN}}, waiting=False)
    run.extrinsics.wait_no_more()
    run.send('left', 'right', 'imu', 'right')
    assert run.sensors == ['left', 'imu']
    assert run.extrinsics.drops == {('right', 'unplaced'): 2}
    assert 'lidar_left_out' in {finding.rule for finding in run.extrinsics.findings}


def test_what_only_the_parameters_tell_is_to_be_published_after_a_while(patience):
    given = {'T_base_sensor': [*LEFT, 0.0, 0.0, 0.0, 1.0]}
    run = Run({**GIVEN_REST, 'lidars': {'left': given, 'right': given}}, waiting=False)
    run.extrinsics.static(transforms(('base_link', 'velo_right', *RIGHT)))
    run.send('left', 'right')
    assert run.extrinsics.untold() == {}
    patience(0.0)
    found = run.extrinsics.untold()
    assert list(found) == ['velo_left']
    assert tuple(found['velo_left'][:3, 3]) == LEFT
    run.send('imu')
    assert list(run.extrinsics.untold()) == ['velo_left', 'imu']
    run.extrinsics.static(transforms(('base_link', 'imu', 0.0, 0.0, 0.0)))
    assert list(run.extrinsics.untold()) == ['velo_left']


def test_a_lidar_that_comes_back_under_a_name_that_no_transform_knows_keeps_its_place(patience):
    patience(0.0)
    run = Run(GIVEN_REST)
    run.send('left', 'right', 'imu', 'gnss')
    run.extrinsics.static(BOTH)
    run.send_from('right', 'velo_other')
    assert len(run.renewals) == 1 and run.sensors[-1] == 'right'
    assert run.extrinsics.drops == {('right', 'unplaced'): 1}  # before it was placed
    (told,) = run.extrinsics.findings
    assert told.rule == 'frame_renamed' and told.sensor == 'right'
    assert 'velo_other' in told.text and 'velo_right' in told.text
    run.send_from('right', 'velo_right')
    assert run.extrinsics.findings == () and len(run.renewals) == 1


def test_a_lidar_that_comes_back_under_a_name_of_another_place_is_placed_there(patience):
    patience(0.0)
    run = Run(GIVEN_REST)
    run.extrinsics.static(BOTH)
    run.extrinsics.static(transforms(('base_link', 'velo_rear', -1.0, 0.0, 2.0)))
    run.send('left', 'right', 'imu', 'gnss')
    placed = len(run.renewals)
    run.send_from('right', 'velo_rear')
    (moved,) = run.renewals[placed:]
    assert moved.settings['lidars']['right']['T_base_sensor'][:3] == [-1.0, 0.0, 2.0]
    assert not moved.optional and run.extrinsics.findings == ()


def test_a_sensor_that_is_placed_late_is_worth_a_new_map_and_one_that_is_moved_is_not(patience):
    patience(0.0)
    run = Run(GIVEN_REST)
    run.send('left', 'right', 'imu', 'gnss')
    run.extrinsics.static(BOTH)
    run.extrinsics.static(transforms(('base_link', 'velo_left', 1.0, 0.5, 3.0)))
    assert [renewal.optional for renewal in run.renewals] == [False, True]
    assert 'left' in run.renewals[1].reason and 'right' not in run.renewals[1].reason


def test_what_nobody_tells_is_not_published(patience):
    patience(0.0)
    run = Run({}, waiting=False)
    run.send('left', 'right', 'imu')
    assert run.extrinsics.untold() == {}


def test_the_base_may_have_another_name():
    run = Run(GIVEN_REST, config=merged_config(frames={'base': 'vehicle'}))
    run.send('left', 'imu', 'right', 'gnss')
    run.extrinsics.static(
        transforms(
            ('vehicle', 'base_link', 9.0, 9.0, 9.0),
            ('vehicle', 'velo_left', *LEFT),
            ('vehicle', 'velo_right', *RIGHT),
        )
    )
    lidars = run.renewals[0].settings['lidars']
    assert tuple(lidars['left']['T_base_sensor'][:3]) == LEFT


def merged_config(**sections):
    return make_config({'lidars': {'names': ['left', 'right']}, **sections})
