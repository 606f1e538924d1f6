"""The worker by itself: a real mapper in its thread, and what becomes of both where it fails."""

import json
import os
import resource
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from drive_edits import driven_later
from scan_processes import scan_processes

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import InputError
from incremental_mapper.mapping import beginning
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.watch import Watch
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.ros import worker as worker_module
from incremental_mapper.ros.inbox import Command, Order, Renewal, View
from incremental_mapper.ros.updates import (
    Reply,
    Restarted,
    Retimed,
    Trouble,
    ViewUpdate,
    WindowUpdate,
)
from incremental_mapper.ros.worker import Worker
from incremental_mapper.settings import merge, to_tree

QUICK = {'selection': {'strategy': 'min_time_shift'}, 'odometry': {'method': 'gicp'}}


class Run:
    """A worker, the drive that it maps, and everything that it told."""

    def __init__(self, drive, tree):
        source = open_source(drive, merge(QUICK, tree))
        self.config = effective_config(source, merge(QUICK, tree), 'test')
        self.measurements = list(source.measurements())
        self.told = []
        self.worker = Worker(self.config, self.told.append)
        self.worker.start()
        self._tickets = 0

    def of(self, kind):
        return [item for item in list(self.told) if isinstance(item, kind)]

    def wait(self, condition, what):
        end = time.monotonic() + 60.0
        while not condition():
            assert self.worker.running(), f'the worker has ended: {what}'
            assert time.monotonic() < end, f'timed out: {what}'
            time.sleep(0.005)

    def order(self, order):
        """Give an order; returns success and message."""
        self._tickets += 1
        ticket = self._tickets
        self.worker.inbox.put(Command(order, ticket))

        def replies():
            return [item for item in self.of(Reply) if item.ticket == ticket]

        self.wait(replies, f'reply to {order}')
        (reply,) = replies()
        return reply.success, reply.message

    def feed(self, measurements):
        for item in measurements:
            self.worker.inbox.put(item)

    def view(self, view):
        seen = len(self.of(ViewUpdate))
        self.worker.inbox.request(view)
        self.wait(lambda: len(self.of(ViewUpdate)) > seen, f'the view {view}')
        return self.of(ViewUpdate)[-1]

    def stop(self, seconds=60.0):
        self.worker.begin_stop(seconds)
        self.worker.join()


@pytest.fixture
def start(light_drive, tmp_path):
    """Start a worker on ``light_drive``; it is stopped in the end."""
    runs = []

    def make(tree=None):
        saving = {'save': {'folder': str(tmp_path / 'saved'), 'pictures': False}}
        runs.append(Run(light_drive, merge(saving, tree or {})))
        return runs[-1]

    yield make
    for run in runs:
        if run.worker.running():
            run.stop()


def on_disk(folder):
    """Settings that keep the scans in ``folder``, which is made."""
    folder.mkdir()
    return {'map': {'store': 'disk', 'store_folder': str(folder)}}


def empty_store(folder):
    """Take away what a store has written to ``folder``, as a failing disk would."""
    found = [
        path
        for path in Path('/proc/self/fd').iterdir()
        if path.is_symlink() and str(path.readlink()).startswith(str(folder))
    ]
    # The candidates lie there too, and take less.
    os.truncate(max(found, key=lambda path: path.stat().st_size), 0)


def troubles(run):
    return '\n'.join(item.message for item in run.of(Trouble))


def scans_and_fixes(measurements):
    return Counter(item.sensor for item in measurements if item.sensor != 'imu')


def test_windows_are_those_of_the_mapper_alone(start):
    run = start()
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    mapper = Mapper(run.config, [*run.config.lidars, 'imu', 'gnss'])
    results = [result for item in run.measurements for result in mapper.push(item)]
    results += mapper.flush()
    updates = run.of(WindowUpdate)
    assert [item.result.row['members'] for item in updates] == [
        result.row['members'] for result in results
    ]
    assert updates[-1].stats['vertices'] == mapper.stats()['vertices'] > 10
    in_range = [
        (np.linalg.norm(scan.points, axis=1) <= run.config.map.max_range).sum()
        for scan in mapper.state.scans
    ]
    assert sum(len(item.points) for item in updates) == sum(in_range)
    assert run.worker.scan_bytes == sum(scan.stored.nbytes for scan in mapper.state.scans)
    assert run.worker.failures == 0 and not run.of(Restarted)


def test_odometry_frame_does_not_jump_when_the_map_is_turned(start):
    run = start()
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    updates = run.of(PoseUpdate)
    assert run.of(WindowUpdate)[-1].stats['georeferenced']
    speed = max(np.linalg.norm(item.newest.velocity) for item in updates)

    def fastest(poses):
        """Largest step between two windows, in m/s."""
        places = np.array([pose.translation() for pose in poses])
        seconds = np.diff([item.newest.stamp for item in updates]) / 1e9
        return (np.linalg.norm(np.diff(places, axis=0), axis=1) / seconds).max()

    assert fastest([item.odometry.pose for item in updates]) < 1.5 * speed
    assert fastest([item.newest.pose for item in updates]) > 3.0 * speed, 'the map was turned'


def test_reset_without_a_place_for_the_map_is_answered_and_the_worker_lives(start, tmp_path):
    folder = tmp_path / 'store'
    run = start(on_disk(folder))
    folder.rmdir()
    success, message = run.order(Order.RESET)
    assert not success and str(folder) in message
    assert run.worker.failures == 1
    assert f'{folder}: cannot hold the map' in troubles(run)
    for order in (Order.FLUSH, Order.SAVE):
        success, message = run.order(order)
        assert not success and 'no map' in message
    run.worker.inbox.request(View.MAP)
    some = run.measurements[:200]
    run.feed(some)
    assert not run.order(Order.FLUSH)[0]
    lost = Counter(item.sensor for item in some)
    assert run.worker.drops() == {(name, 'mapper_failed'): count for name, count in lost.items()}
    assert not run.of(WindowUpdate)
    folder.mkdir()
    assert run.order(Order.RESET)[0]
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    assert run.order(Order.SAVE)[0]
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert stats['vertices'] > 10
    assert len(run.view(View.MAP).content) > 1000
    assert run.worker.failures == 1


def test_second_failure_while_the_first_is_mended_is_counted_too(start, tmp_path, monkeypatch):
    monkeypatch.setattr(worker_module, 'RETRY', 3600.0)
    folder = tmp_path / 'store'
    run = start(on_disk(folder))
    half = len(run.measurements) // 2
    run.feed(run.measurements[:half])
    assert run.order(Order.FLUSH)[0]
    empty_store(folder)
    folder.rmdir()
    run.worker.inbox.request(View.MAP)
    run.feed(run.measurements[half:])
    assert not run.order(Order.SAVE)[0]
    assert run.worker.failures == 2
    assert 'the map cannot be read back' in troubles(run)
    assert f'{folder}: cannot hold the map' in troubles(run)
    assert len(run.of(Restarted)) == 1
    lost = Counter(item.sensor for item in run.measurements[half:])
    drops = run.worker.drops()
    assert {name: drops[name, 'mapper_failed'] for name in lost} == lost


def test_worker_tries_again_by_itself(start, tmp_path, monkeypatch):
    monkeypatch.setattr(worker_module, 'RETRY', 0.0)
    folder = tmp_path / 'store'
    run = start(on_disk(folder))
    folder.rmdir()
    assert not run.order(Order.RESET)[0]
    run.feed(run.measurements[:5])
    run.wait(lambda: run.worker.failures == 6, 'five more attempts')
    assert run.worker.drops().total() == 5
    folder.mkdir()
    run.feed(run.measurements[5:])
    assert run.order(Order.FLUSH)[0]
    assert run.worker.failures == 6 and run.worker.drops().total() == 5
    assert run.of(WindowUpdate)[-1].stats['received']['left'] > 10


def test_mapper_that_cannot_be_made_leaves_no_process_behind(start, tmp_path):
    folder = tmp_path / 'store'
    run = start(merge(on_disk(folder), {'odometry': {'processes': True}}))
    assert scan_processes()  # the seed, which forks the others when it is ready
    folder.rmdir()
    for _ in range(3):
        assert not run.order(Order.RESET)[0]
    assert scan_processes() == []


def test_no_worker_without_a_place_for_the_map(light_drive, tmp_path):
    tree = {'map': {'store': 'disk', 'store_folder': str(tmp_path / 'nowhere')}}
    with pytest.raises(Exception, match='nowhere: cannot hold the map'):
        Run(light_drive, tree)


def test_stop_maps_what_waits_and_saves_it(start, tmp_path):
    run = start({'save': {'on_shutdown': str(tmp_path / 'last')}})
    run.feed(run.measurements)
    run.stop()
    graph = json.loads((tmp_path / 'last' / 'graph.json').read_text())
    used = Counter(core['sensor'] for item in graph['clusters'] for core in item['members'])
    assert used == scans_and_fixes(run.measurements)
    assert 'saved to' in troubles(run)


def test_what_is_left_at_the_deadline_is_counted(start):
    run = start()
    run.feed(run.measurements)
    run.stop(0.0)
    received = Counter()
    for update in run.of(WindowUpdate)[-1:]:
        received.update(update.stats['received'])
    shut = Counter()
    for (name, reason), count in run.worker.drops().items():
        assert reason == 'shutdown'
        shut[name] += count
    assert shut.total() > len(run.measurements) // 2
    assert received + shut == Counter(item.sensor for item in run.measurements)


def test_map_whose_points_are_lost_is_saved_without_them_and_it_is_told(start, tmp_path):
    folder = tmp_path / 'store'
    run = start(merge(on_disk(folder), {'save': {'on_shutdown': str(tmp_path / 'last')}}))
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    empty_store(folder)
    run.stop()
    assert 'the map cannot be read back' in troubles(run)
    assert run.worker.saves.failed == 1
    # What does not lie on that disk is saved all the same.
    saved = FinishedRun(tmp_path / 'last')
    assert len(saved.trajectory.stamps) > 10 and len(saved.points) == 0
    assert 'scans_unreadable' in [item['rule'] for item in saved.stats['warnings']]


GRAVITY = Finding(
    'imu_in_g', Severity.MENDED, 'imu', 'too weak', settings={'preintegration': {'gravity': 9.7}}
)
CLOCK = Finding('clock', Severity.MENDED, 'gnss', 'late', settings={'gnss': {'time_offset': 0.05}})


@pytest.fixture
def rule(monkeypatch):
    """Let a map's watch find something with its measurement of a number."""

    def install(number, *findings):
        def measurement(watch, item):
            watch.seen = getattr(watch, 'seen', 0) + 1
            for finding in findings:
                (section,) = finding.settings
                (name,) = finding.settings[section]
                found = to_tree(watch._config)[section][name]
                if watch.seen == number and found != finding.settings[section][name]:
                    watch.add(finding)

        monkeypatch.setattr(Watch, 'measurement', measurement)

    return install


def test_settings_that_proved_wrong_are_mended_and_nothing_is_lost(start, rule, tmp_path):
    rule(100, GRAVITY)
    run = start()
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0] and run.order(Order.SAVE)[0]
    (restarted,) = run.of(Restarted)
    assert 'imu_in_g' in restarted.reason and restarted.findings == (GRAVITY,)
    assert (
        run.worker.config.preintegration.gravity == restarted.config.preintegration.gravity == 9.7
    )
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert stats['dropped'] == {}
    assert stats['received'] == dict(Counter(item.sensor for item in run.measurements))
    assert [item['rule'] for item in stats['warnings']] == ['imu_in_g']
    assert stats['settings']['preintegration']['gravity'] == 9.7
    assert run.of(WindowUpdate)[-1].findings == (GRAVITY,)


SCATTER = Finding(
    'optimistic_covariance', Severity.MENDED, 'gnss', '', settings={'fixes': {'min_sigma': 9.0}}
)
EXCHANGED = Finding(
    'exchanged_degrees', Severity.MENDED, 'gnss', '', settings={'fixes': {'min_status': 1}}
)


def test_what_followed_from_a_mended_track_of_fixes_is_taken_back(start):
    run = start()
    given = run.worker.config.fixes.min_sigma
    run.worker.inbox.put(Renewal(SCATTER.settings, 'scattered', (SCATTER,)))
    run.worker.inbox.put(Renewal(EXCHANGED.settings, 'exchanged', (EXCHANGED,)))
    assert run.order(Order.RESET)[0]
    assert run.worker.config.fixes.min_status == 1
    assert run.worker.config.fixes.min_sigma == given != 9.0
    assert run.of(Restarted)[-1].findings == (EXCHANGED,)


def test_stamps_of_all_measurements_follow_a_mended_clock(start, rule, tmp_path):
    rule(150, CLOCK)
    run = start()
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0] and run.order(Order.SAVE)[0]
    graph = json.loads((tmp_path / 'saved' / 'graph.json').read_text())
    members = [item for cluster in graph['clusters'] for item in cluster['members']]
    found = sorted(item['stamp_ns'] for item in members if item['sensor'] == 'gnss')
    fixes = [item.stamp for item in run.measurements if item.sensor == 'gnss']
    assert found == [stamp + 50_000_000 for stamp in fixes]


def test_measurements_of_a_map_that_is_too_long_to_be_made_again_are_counted(
    start, rule, tmp_path, monkeypatch
):
    monkeypatch.setattr(beginning, 'MOST_SECONDS', 0.2)
    rule(100, GRAVITY)
    run = start()
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0] and run.order(Order.SAVE)[0]
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    lost = sum(reasons['before_mend'] for reasons in stats['dropped'].values())
    assert lost == 100 and sum(stats['received'].values()) == len(run.measurements) - 100


def test_a_map_that_is_too_long_to_be_made_again_goes_on_where_stamps_are_put_right(
    start, tmp_path, monkeypatch
):
    monkeypatch.setattr(beginning, 'MOST_SECONDS', 0.2)
    run = start()
    found = Finding(
        'clock_offset', Severity.MENDED, 'gnss', 'late', settings={'gnss': {'time_offset': 0.05}}
    )
    half = len(run.measurements) // 2
    run.feed(run.measurements[:half])
    run.worker.inbox.put(Renewal(found.settings, 'late', (found,)))
    run.feed(run.measurements[half:])
    assert run.order(Order.FLUSH)[0] and run.order(Order.SAVE)[0]
    assert not run.of(Restarted)
    (retimed,) = run.of(Retimed)
    assert retimed.config.gnss.time_offset == run.worker.config.gnss.time_offset == 0.05
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert stats['received'] == dict(Counter(item.sensor for item in run.measurements))
    assert 'clock_offset' in [item['rule'] for item in stats['warnings']]
    graph = json.loads((tmp_path / 'saved' / 'graph.json').read_text())
    members = [item for cluster in graph['clusters'] for item in cluster['members']]
    found_stamps = sorted(item['stamp_ns'] for item in members if item['sensor'] == 'gnss')
    moved = [
        item.stamp + 50_000_000 * (number >= half)
        for number, item in enumerate(run.measurements)
        if item.sensor == 'gnss'
    ]
    assert found_stamps == moved


def test_windows_that_are_closed_on_order_say_so(start):
    run = start()
    run.feed(run.measurements[: len(run.measurements) // 2])
    run.wait(lambda: len(run.of(WindowUpdate)) > 5, 'windows')
    assert run.order(Order.FLUSH)[0]
    said = [item.on_order for item in run.of(WindowUpdate)]
    assert said == sorted(said) and not said[0] and said[-1]


MOVED = {'gnss': {'T_base_sensor': [0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0]}}


def test_a_map_that_is_too_long_to_be_made_again_goes_on_where_a_place_is_told_anew(
    start, tmp_path, monkeypatch
):
    monkeypatch.setattr(beginning, 'MOST_SECONDS', 0.2)
    run = start()
    half = len(run.measurements) // 2
    run.feed(run.measurements[:half])
    run.worker.inbox.put(Renewal(MOVED, 'told anew', optional=True))
    run.feed(run.measurements[half:])
    assert run.order(Order.FLUSH)[0] and run.order(Order.SAVE)[0]
    assert not run.of(Restarted)
    assert 'told anew' in run.of(Trouble)[0].message and 'reset' in run.of(Trouble)[0].message
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert stats['received'] == dict(Counter(item.sensor for item in run.measurements))
    assert stats['settings']['gnss']['T_base_sensor'][2] != 2.0
    assert run.order(Order.RESET)[0] and run.worker.config.gnss.T_base_sensor[2] == 2.0


def test_a_map_that_ends_for_a_sensor_that_was_at_no_place_is_saved(start, tmp_path, monkeypatch):
    monkeypatch.setattr(beginning, 'MOST_SECONDS', 0.2)
    run = start({'save': {'on_shutdown': str(tmp_path / 'ended')}})
    half = len(run.measurements) // 2
    run.feed(run.measurements[:half])
    run.worker.inbox.put(Renewal(MOVED, 'placed late'))
    run.feed(run.measurements[half:])
    assert run.order(Order.FLUSH)[0]
    assert len(run.of(Restarted)) == 1
    run.stop()
    saved = [json.loads((path / 'stats.json').read_text()) for path in tmp_path.glob('ended*')]
    assert sum(sum(stats['received'].values()) for stats in saved) == len(run.measurements)
    assert not any('before_mend' in of for stats in saved for of in stats['dropped'].values())


def test_a_map_is_not_mended_for_ever(start, monkeypatch):
    def measurement(watch, item):
        gravity = watch._config.preintegration.gravity
        settings = {'preintegration': {'gravity': gravity + 0.001}}
        watch.add(Finding('never_content', Severity.MENDED, 'imu', 'again', settings=settings))

    monkeypatch.setattr(Watch, 'measurement', measurement)
    run = start()
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    assert len(run.of(Restarted)) == 3
    assert run.of(WindowUpdate)[-1].stats['vertices'] > 10


def test_settings_that_come_before_the_first_measurement_are_no_restart(start):
    run = start()
    settings = {'gnss': {'T_base_sensor': [0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0]}}
    run.worker.inbox.put(Renewal(settings, 'found'))
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    assert [item.reason for item in run.of(Restarted)] == ['']
    assert run.worker.config.gnss.T_base_sensor[2] == 2.0
    assert run.of(WindowUpdate)[0].result.index == 0


def test_a_map_with_an_error_is_saved_but_no_success(start, monkeypatch, tmp_path):
    error = Finding('no_usable_scan', Severity.ERROR, 'left', 'no scan could be used', 'look')
    run = start()
    run.worker.outside_findings = lambda: (error,)
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    assert run.order(Order.SAVE) == (
        False,
        f'saved to {tmp_path / "saved"}; error: left: no scan could be used (no_usable_scan); look',
    )
    stats = json.loads((tmp_path / 'saved' / 'stats.json').read_text())
    assert stats['warnings'][0]['severity'] == 'error'


def test_store_that_fills_up_costs_no_map(start, tmp_path):
    run = start(merge(on_disk(tmp_path / 'store'), {'save': {'on_shutdown': str(tmp_path / 'l')}}))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    half = len(run.measurements) // 2
    run.feed(run.measurements[:half])
    assert run.order(Order.FLUSH)[0]
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        run.feed(run.measurements[half:])
        assert run.order(Order.FLUSH)[0]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    run.stop()
    assert run.worker.failures == 0
    saved = FinishedRun(tmp_path / 'l')
    used = Counter(core['sensor'] for item in saved.graph['clusters'] for core in item['members'])
    assert used == scans_and_fixes(run.measurements)
    assert 'store_full' in [item['rule'] for item in saved.stats['warnings']]
    assert len(saved.points) > 10_000


def journals(folder):
    return sorted(path.name for path in folder.glob('*.journal'))


def test_autosave_is_a_journal_that_the_next_start_makes_a_map_of(start, tmp_path):
    autosave = {'save': {'every': 0.2}}
    run = start(autosave)
    assert len(journals(tmp_path / 'saved_autosave')) == 1
    run.feed(run.measurements)
    assert run.order(Order.FLUSH)[0]
    run.stop()
    (name,) = journals(tmp_path / 'saved_autosave')
    assert f'"incremental_mapper recover {tmp_path / "saved_autosave" / name}"' in troubles(run)
    again = start(autosave)
    again.wait(lambda: 'recovered to' in troubles(again), 'the map of before')
    saved = FinishedRun(tmp_path / 'saved_autosave' / name.removesuffix('.journal'))
    used = Counter(core['sensor'] for item in saved.graph['clusters'] for core in item['members'])
    assert used == scans_and_fixes(run.measurements)
    assert len(saved.points) > 10_000
    assert len(journals(tmp_path / 'saved_autosave')) == 1, 'that of the map that goes on'
    again.stop()
    assert journals(tmp_path / 'saved_autosave') == [], 'there is nothing in it'


def test_map_that_is_saved_or_discarded_leaves_no_journal(start, tmp_path):
    folder = tmp_path / 'journals'
    run = start({'journal': {'folder': str(folder)}, 'save': {'on_shutdown': str(tmp_path / 'l')}})
    run.feed(run.measurements[: len(run.measurements) // 2])
    assert run.order(Order.FLUSH)[0]
    (before,) = (path.stat().st_size for path in folder.glob('*.journal'))
    assert run.order(Order.RESET)[0]
    (after,) = (path.stat().st_size for path in folder.glob('*.journal'))
    assert after < before / 10, 'it is that of the new map'
    run.feed(run.measurements)
    run.stop()
    assert run.worker.failures == 0 and run.worker.saves.failed == 0
    assert (tmp_path / 'l' / 'map.ply').exists()
    assert journals(folder) == []


def test_nothing_mapped_at_the_end_is_a_failed_save(start, tmp_path):
    run = start({'save': {'on_shutdown': str(tmp_path / 'last')}})
    run.stop()
    assert run.worker.saves.failed == 1
    assert 'the map is empty' in troubles(run)


def test_a_session_goes_on_from_a_saved_map(light_drive, tmp_path):
    first = Run(light_drive, {'save': {'folder': str(tmp_path / 'first'), 'pictures': False}})
    first.feed(first.measurements)
    first.order(Order.FLUSH)
    assert first.order(Order.SAVE)[0]
    first.stop()
    later = driven_later(light_drive, tmp_path / 'later')
    going_on = {'continue': str(tmp_path / 'first')}
    saving = {'folder': str(tmp_path / 'both'), 'pictures': False}
    second = Run(later, {'session': going_on, 'save': saving})
    second.feed(second.measurements)
    second.order(Order.FLUSH)
    updates = second.of(WindowUpdate)
    rules = [[finding.rule for finding in update.findings] for update in updates]
    assert 'session_apart' in rules[0] and updates[0].stats['session'] == 'apart'
    assert 'session_apart' not in rules[-1] and updates[-1].stats['session'] == 'joined'
    assert second.order(Order.SAVE)[0]
    second.stop()
    one, both = FinishedRun(tmp_path / 'first'), FinishedRun(tmp_path / 'both')
    assert both.stats['components'] == 1 and len(both.stats['sessions']) == 2
    assert both.stats['datum'] == one.stats['datum']
    assert len(both.trajectory) == both.stats['clusters'] > 1.5 * one.stats['clusters']


def test_a_worker_refuses_to_go_on_from_what_is_no_map(light_drive, tmp_path):
    with pytest.raises(InputError, match='is no output of'):
        Run(light_drive, {'session': {'continue': str(tmp_path)}})
