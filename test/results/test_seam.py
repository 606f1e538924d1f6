"""A recording in two files: what holds the second session where the first one ends."""

from collections import Counter
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from incremental_mapper.cli.main import main
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.map.store import MemoryStore
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.results.sessions.going_on import EarlierMap
from incremental_mapper.results.sessions.joining import turned
from incremental_mapper.results.sessions.saved_run import read_saved_run
from incremental_mapper.results.sessions.seam import LONGEST, seam_factors
from incremental_mapper.settings import make_config
from incremental_mapper.variables import pose_key, velocity_key

CONFIG = make_config({'closure': {'enabled': False}})
GAP = 0.06


@pytest.fixture(scope='module')
def run(light_drive, tmp_path_factory):
    """A drive that was mapped."""
    place = tmp_path_factory.mktemp('seam')
    (place / 'quick.yaml').write_text(
        'selection: {strategy: min_time_shift}\nodometry: {processes: false}\n'
    )
    words = ['map', str(light_drive), str(place / 'run'), '--config', str(place / 'quick.yaml')]
    assert main(words) == 0
    return read_saved_run(place / 'run', MemoryStore())


def follows(part, gap=GAP, aside=0.0):
    """The same drive again, where and as fast as the first one leads, after ``gap`` seconds."""
    last, first = part.clusters[-1], part.clusters[0]
    by = last.cluster.stamp - first.cluster.stamp + round(gap * NANOSECONDS)
    clusters = tuple(
        replace(
            item,
            cluster=replace(
                item.cluster,
                members=tuple(replace(one, stamp=one.stamp + by) for one in item.cluster.members),
            ),
        )
        for item in part.clusters
    )
    there = part.values.atPose3(pose_key(last.id))
    speed = part.values.atVector(velocity_key(last.id))
    place = there.translation() + gap * speed + np.array([aside, 0.0, 0.0])
    begin = part.values.atPose3(pose_key(first.id))
    moved = gtsam.Pose3(there.rotation(), place).compose(begin.inverse())
    return turned(replace(part, clusters=clusters, sessions=()), moved, CONFIG)


def test_motion_and_bias_are_carried_over_the_cut(run):
    part = run.result
    after = follows(part)
    motion, walk = seam_factors(part, after, CONFIG)
    count, last = len(part.clusters), part.clusters[-1].id
    assert (
        motion.keys == (pose_key(last), pose_key(count))
        and motion.kind is FactorKind.DEAD_RECKONING
    )
    assert walk.kind is FactorKind.BIAS_RANDOM_WALK
    speeds = [
        values.atVector(velocity_key(number))
        for values, number in ((part.values, last), (after.values, after.clusters[0].id))
    ]
    wanted = part.values.atPose3(pose_key(last)).rotation().unrotate(0.5 * GAP * sum(speeds))
    assert np.allclose(motion.factor.measured().translation(), wanted, atol=1e-9)


def test_the_joint_map_counts_them_and_hangs_together(run):
    part = run.result
    whole = EarlierMap(run, run.datum).map_of_both(
        follows(part), CONFIG, InputFacts('here', 'test', {})
    )
    stats = whole.result.statistics
    assert stats.components == 1 and stats.factors == len(whole.result.factors)
    kinds = Counter(str(factor.kind) for factor in whole.result.factors)
    assert dict(stats.factors_by_kind) == dict(kinds)
    assert len(whole.result.factors) == 2 * len(part.factors) + 2


@pytest.mark.parametrize(
    ('gap', 'aside'), [(1.5 * LONGEST, 0.0), (-1.0, 0.0), (GAP, 5.0)]
)  # after a break, at the same time, and another vehicle
def test_what_does_not_go_on_is_not_held(run, gap, aside):
    assert seam_factors(run.result, follows(run.result, gap, aside), CONFIG) == []
