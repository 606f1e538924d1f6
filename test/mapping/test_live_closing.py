"""A street driven there and back: the loop is closed while the map grows, and the map goes on."""

import math
from itertools import pairwise

import gtsam
import numpy as np
import pytest
from test_loop_closing import SETTINGS, STEP, errors, way
from town import pose, seen_points, town

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.closures.search import LEFT
from incremental_mapper.config import Config
from incremental_mapper.graph.factors import FactorKind, between_factor, pose_prior, pose_sigmas
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.map.store import MemoryStore
from incremental_mapper.mapping import live_closing, loop_closing
from incremental_mapper.mapping.final_solve import final_values
from incremental_mapper.mapping.live_closing import (
    MOST_FAILED,
    NO_MORE,
    Arrived,
    LiveLoops,
    RunHere,
    live,
)
from incremental_mapper.mapping.loop_closing import close_loops, solve_with_closures
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.odometry_frame import OdometryFrame
from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.graph_state import GraphState, PlacedCluster, PlacedScan
from incremental_mapper.smoothing.smoother import smoother_update
from incremental_mapper.variables import pose_key

SCANS_EVERY, LAG = 4, 6
LIVE = Config.model_validate({'closure': {'candidates': 1, 'live_period': 1e-6}})


class Drive:
    """G(t) that grows along the way; its odometry reads 1 % too little and turns to the left."""

    def __init__(self, share=1):
        """``share``: one of so many points is seen."""
        on = [pose(float(x), 3.0, 180.0) for x in range(-41, -66, -1)]
        self.true, self.points, self.store = [*way(), *on], town(1)[::share], MemoryStore()
        self.state = GraphState(store=self.store)
        self.number = 0

    def go(self):
        """A window."""
        state, number = self.state, self.number
        key, initial = pose_key(number), gtsam.Values()
        if number == 0:
            initial.insert(key, self.true[0])
            factor = pose_prior(key, self.true[0], pose_sigmas(0.01, 0.001), 0)
        else:
            motion = self.true[number - 1].between(self.true[number])
            turned = motion.rotation().compose(gtsam.Rot3.Yaw(5e-4))
            wrong = gtsam.Pose3(turned, 0.99 * motion.translation())
            initial.insert(key, state.pose(number - 1).compose(wrong))
            keys, stamps = (pose_key(number - 1), key), (number - 1, number)
            factor = between_factor(FactorKind.ODOMETRY, keys, wrong, STEP, 'top', stamps)
        prior, _ = smoother_update(state.prior, [factor.factor], initial, {number: number}, 20)
        core = CoreMeasurement(number, 'top', CoreKind.LIDAR)
        scans = []
        if number % SCANS_EVERY == 0:
            seen = seen_points(self.points, self.true[number], number, 0.15)
            scan = PlacedScan(number, number, 'top', self.store.put(seen), gtsam.Pose3())
            scans = [(scan, seen[:10])]
        state.add_clusters([PlacedCluster(number, number, Cluster((core,)))], scans, [])
        state.add_factors([factor], prior)
        frontier = Frontier(head=number, newest=number, newest_stamp=number, head_stamp=number)
        state.advance(frontier, np.zeros(3), number - LAG)
        self.number += 1

    @property
    def off(self):
        """Metres that the newest pose is off."""
        newest = self.number - 1
        apart = self.state.pose(newest).translation() - self.true[newest].translation()
        return float(np.linalg.norm(apart))

    @property
    def normalised(self):
        """The squared error of the newest pose, in standard deviations, per dimension."""
        newest = self.number - 1
        apart = self.state.pose(newest).localCoordinates(self.true[newest])
        covariance = self.state.prior.covariance(pose_key(newest))
        return float(apart @ np.linalg.solve(covariance, apart)) / 6.0


class Late(RunHere):
    """Gives its answer when asked for the ``after``th time."""

    def __init__(self, after):
        super().__init__()
        self.after, self.asked, self.searches, self.results = after, 0, 0, []

    def start(self, search):
        self.asked = 0
        self.searches += 1
        super().start(search)
        self.results.append(self._arrived)
        return True

    def arrived(self):
        self.asked += 1
        return super().arrived() if self.asked >= self.after else None


class Canned(RunHere):
    """Always gives the same answer."""

    def __init__(self, answer):
        super().__init__()
        self.answer, self.searches = answer, 0

    def start(self, search):
        self.searches += 1
        return True

    def arrived(self):
        return self.answer


@pytest.fixture(scope='module', autouse=True)
def no_pause():
    """Here a window takes a fraction of what it takes on the road."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live_closing, 'PACE', 0.0)
        patch.setattr(live_closing, 'PART', 7)  # values come back in many parts
        yield


@pytest.fixture(scope='module')
def closed(no_pause):
    """The whole way with loops closed along it; what was said, and the errors at each window."""
    drive, runner = Drive(), Late(9)
    loops = LiveLoops(drive.state, LIVE, runner)
    frame = OdometryFrame(LIVE.odometry)
    rows = []
    for _ in drive.true:
        drive.go()
        told = odometry(drive.state, frame)
        off, normalised = drive.off, drive.normalised
        said = loops.step()
        rows.append((said, told, off, drive.off, normalised, drive.normalised))
    return drive, loops, runner, rows


def odometry(state, frame):
    newest = state.frontier.newest
    covariance = state.prior.covariance(pose_key(newest))
    return frame.follow(state, NewestState(newest, state.pose(newest), covariance, np.zeros(3)))


def test_the_map_is_closed_while_it_grows(closed):
    drive, loops, runner, rows = closed
    said = [row for row in rows if row[0]]
    assert loops.closed == len(said) >= 1 and 'loops closed' in said[0][0].text
    # A search takes some windows here, and each goes on from what the one before has tested.
    assert runner.searches >= 3
    open_end = open_drive(len(drive.true))
    assert open_end.off > 5.0 and drive.off < 1.0
    assert errors(drive.state.all_values(), drive.true).max() < 1.0
    counted = loops.told
    assert counted['accepted'] == len(drive.state.closures) >= 3


def test_what_is_mapped_next_does_not_fight_the_closure(closed):
    _, _, _, rows = closed
    first = next(place for place, row in enumerate(rows) if row[0])
    _, _, off, off_after, normalised, normalised_after = rows[first]
    assert off_after < 0.5 * off
    # It knew that it might be that far off; it knows better now, and is as right about that.
    assert normalised_after < max(2.0 * normalised, 3.0)
    # The windows after it stay where it has put them.
    assert max(row[3] for row in rows[first:]) < 1.0
    assert max(row[5] for row in rows[first:]) < 3.0


def test_odometry_does_not_jump_with_the_map(closed):
    drive, _, _, rows = closed
    for (before, after), (told_before, told_after) in zip(
        pairwise(drive.true), pairwise([row[1] for row in rows]), strict=True
    ):
        true = before.between(after)
        step = told_before.pose.between(told_after.pose)
        assert np.linalg.norm(true.translation() - step.translation()) < 0.05
    jumps = [
        np.linalg.norm(one.T_map_odom.translation() - other.T_map_odom.translation())
        for one, other in pairwise([row[1] for row in rows])
    ]
    assert max(jumps) > 0.5


def test_it_is_what_one_solve_of_everything_says(closed):
    drive, _, _, _ = closed
    state = drive.state
    plain = [factor.factor for factor in state.factors]
    whole = solve_with_closures(plain, tuple(state.closures), state.all_values())
    assert len(whole.factors) == len(state.closures)
    newest = pose_key(drive.number - 1)
    apart = whole.values.atPose3(newest).localCoordinates(state.pose(drive.number - 1))
    known = np.sqrt(np.diag(state.prior.covariance(newest)))
    assert np.all(np.abs(apart) < 0.2 * known), apart / known
    marginals = gtsam.Marginals(
        make_graph([*plain, *(one.factor for one in state.closures)]), whole.values
    )
    expected = np.sqrt(np.diag(marginals.marginalCovariance(newest)))
    assert known == pytest.approx(expected, rel=0.2)


def test_what_is_saved_has_its_closures_without_comparing_anything_again(closed):
    drive, loops, _, _ = closed
    values, failed = final_values(drive.state, LIVE)
    saved = loops.of_all(values, most=0)
    ends = [one.keys for one in drive.state.closures]
    assert not failed and [one.keys for one in saved.factors] == ends and saved.refused[LEFT] > 0
    assert errors(saved.values, drive.true).max() < 1.0
    more = loops.of_all(values, most=math.inf)
    assert len(more.factors) >= len(ends) and LEFT not in more.refused
    # A map that is searched as a whole when it is saved has no more to tell.
    whole = close_loops(GraphState(clusters=drive.state.clusters, factors=drive.state.factors,
                                   scans=drive.state.scans), values, LIVE)  # fmt: skip
    assert abs(len(more.factors) - len(whole.factors)) <= 1


def test_points_are_gathered_of_those_places_alone_that_are_compared(closed, monkeypatch):
    drive, _, _, _ = closed
    read, cut = [], loop_closing.cut_local_maps

    def spy(*given, wanted):
        read.append(wanted)
        return cut(*given, wanted=wanted)

    monkeypatch.setattr(loop_closing, 'cut_local_maps', spy)
    # What is looked for by its looks is read as a whole.
    monkeypatch.setattr(loop_closing, 'can_recognise', lambda: False)
    values, _ = final_values(drive.state, LIVE)
    saved = LiveLoops(drive.state, LIVE, RunHere()).of_all(values, most=2)
    compared = [pair for pair, outcome in saved.looked.tested.items() if outcome != 'improbable']
    assert len(compared) == 2 and saved.refused[LEFT] > 0
    assert read == [(), {cluster for pair in compared for cluster in pair}]


def test_a_journal_of_it_says_the_same(closed):
    # It has what left the lag as it was then, before the correction and after it.
    drive, _, rows = closed[0], closed[1], closed[3]
    state, before = drive.state, next(place for place, row in enumerate(rows) if row[0])
    open_values = open_drive(before + 1).state.values
    values = state.all_values()
    values.update(open_values)
    newest = pose_key(drive.number - 1)
    assert np.abs(jump(values, open_values.size())).max() > 0.1
    written = GraphState(factors=state.factors, clusters=state.clusters, values=values)
    recovered, _ = final_values(written, LIVE)
    open_state = GraphState(
        factors=state.factors, clusters=state.clusters, values=state.all_values()
    )
    ours, _ = final_values(open_state, LIVE)
    apart = ours.atPose3(newest).localCoordinates(recovered.atPose3(newest))
    assert np.abs(apart).max() < 1e-3


def open_drive(count):
    drive = Drive(50)
    for _ in range(count):
        drive.go()
    return drive


def jump(values, number):
    """What the step to a pose is off, metres."""
    first, second = (values.atPose3(pose_key(i)) for i in (number - 1, number))
    return first.between(second).translation() - np.array([0.99, 0.0, 0.0])


def test_every_variable_is_there_once(closed):
    drive, _, _, _ = closed
    state = drive.state
    assert set(state.all_values().keys()) == {pose_key(i) for i in range(drive.number)}
    assert len(state.prior.clusters) <= LAG + 2 or state.prior.held


def test_a_search_that_fails_is_told_of_once_and_given_up():
    drive, runner = Drive(50), Canned(Arrived(None, trouble='it ended'))
    loops = LiveLoops(drive.state, LIVE, runner)
    said = []
    for _ in drive.true:
        drive.go()
        said.append(loops.step())
    assert [one.text for one in said if one is not None] == ['it ended', f'it ended; {NO_MORE}']
    assert loops._failures == MOST_FAILED and drive.state.prior.held == ()
    assert drive.state.closures == [] and drive.off > 1.0


def test_what_was_found_in_another_frame_is_not_put_in(closed):
    found = next(one for one in closed[2].results if one.search.correction is not None)
    drive, runner = Drive(50), Canned(found)
    loops = LiveLoops(drive.state, LIVE, runner)
    for _ in drive.true[:130]:
        drive.go()
        # As where the map is turned into ENU between a search and its answer.
        drive.state.corrections += 1
        assert loops.step() is None
    assert runner.searches >= 2 and loops.closed == 0 and drive.state.closures == []


def test_without_a_place_passed_twice_nothing_is_searched():
    drive, runner = Drive(50), Late(1)
    loops = LiveLoops(drive.state, LIVE, runner)
    for _ in drive.true[:80]:
        drive.go()
        loops.step()
    assert runner.searches == 0


def test_when_loops_are_closed_live():
    assert live(Config()) and live(SETTINGS)
    for section in (
        {'closure': {'enabled': False}},
        {'closure': {'live_period': 0.0}},
        {'graph': {'final_optimization': False}},
    ):
        assert not live(Config.model_validate(section))
