"""The scans that candidates are judged on: each where it was measured, whatever is merged."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turning_car import CHAINS, LANDMARKS, MS, known_state, motion, problem_of, truth, windows
from turning_car import settings as car_settings

from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.geometry import transform_points
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.variables import pose_key
from incremental_mapper.voxels import thin

WINDOW = {40 * MS: {'left'}, 60 * MS: {'gps'}, 90 * MS: {'right'}}


def true_pose(candidate, problem):
    """The truth as what a candidate was solved for."""
    known = {pose_key(problem.partitions.number(c)): c.stamp for c in candidate.clusters}
    return lambda key: truth(known[key]) if key in known else None


def all_candidates(problem):
    return list(candidates(problem.elements, problem.head, problem.imu))


@settings(deadline=None, max_examples=25)
@given(windows(4), st.randoms(use_true_random=False))
def test_scans_of_solved_clusters_stand_where_they_were_measured(stamps, random):
    problem = problem_of(stamps)
    new = [
        item.core.stamp for item in problem.inputs.prepared.values() if item.core.kind == 'lidar'
    ]
    expected = [truth(stamp).matrix() for stamp in [*new, *CHAINS.values()]]
    every = all_candidates(problem)
    for candidate in random.sample(every, min(len(every), 8)):
        found = problem.local_maps.poses(candidate, true_pose(candidate, problem))
        assert found.shape == (len(expected), 4, 4)
        assert np.abs(found - np.array(expected)).max() < 2e-3


def test_all_scans_of_the_true_local_map_see_the_landmarks_in_one_place():
    problem = problem_of(WINDOW)
    candidate = all_candidates(problem)[-1]
    poses = problem.local_maps.poses(candidate, true_pose(candidate, problem))
    local_map = problem.local_maps.local_map([poses, poses + 1.0])
    assert local_map.fresh == 2
    assert len(local_map.moving) == 4
    assert local_map.poses.tolist() == [poses.tolist(), (poses + 1.0).tolist()]
    for points, pose in zip(local_map.moving, poses, strict=True):
        assert transform_points(pose, points) == pytest.approx(LANDMARKS, abs=0.05)
    assert local_map.fixed.shape == (0, 3)
    assert local_map.origin == pytest.approx(truth(90 * MS).translation(), abs=2e-3)


def test_cluster_of_the_lag_that_was_solved_anew_takes_its_scans_along():
    problem = problem_of(WINDOW)
    candidate = all_candidates(problem)[0]
    solved = true_pose(candidate, problem)
    shifted = truth(0).compose(motion(0, 500 * MS))

    def pose_of(key):
        return shifted if key == pose_key(0) else solved(key)

    found = problem.local_maps.poses(candidate, pose_of)
    for pose, stamp in zip(found[2:], CHAINS.values(), strict=True):
        assert pose == pytest.approx(shifted.compose(motion(0, stamp)).matrix(), abs=1e-9)


def beyond_lag():
    """G(t-1) whose only cluster no longer changes."""
    state = known_state()
    state.advance(Frontier(), np.zeros(3), 10**12)
    return state


def test_scans_beyond_the_lag_are_one_fixed_cloud():
    config = car_settings(mom={'voxel_size': 0.5})
    state = beyond_lag()
    assert not state.in_lag(0)
    problem = problem_of(WINDOW, state, config)
    candidate = all_candidates(problem)[0]
    poses = problem.local_maps.poses(candidate, true_pose(candidate, problem))
    assert len(poses) == 2
    local_map = problem.local_maps.local_map([poses])
    assert len(local_map.moving) == local_map.fresh == 2
    expected = thin(np.vstack([LANDMARKS, LANDMARKS]), 0.5)
    found = local_map.fixed[np.lexsort(local_map.fixed.T)]
    assert found == pytest.approx(expected[np.lexsort(expected.T)], abs=1e-6)


@pytest.mark.parametrize(('recent', 'sensors'), [(1, ['right']), (2, ['left', 'right'])])
def test_no_more_than_the_newest_scans_are_looked_at(recent, sensors):
    config = car_settings(mom={'submap_scans': recent})
    problem = problem_of(WINDOW, config=config)
    candidate = all_candidates(problem)[0]
    found = problem.local_maps.poses(candidate, true_pose(candidate, problem))
    expected = [truth(CHAINS[sensor]).matrix() for sensor in sensors]
    assert found[2:] == pytest.approx(np.array(expected), abs=1e-9)


def test_window_without_any_scan_has_no_moving_one():
    problem = problem_of({40 * MS: {'gps'}}, beyond_lag())
    candidate = all_candidates(problem)[0]
    assert problem.local_maps.poses(candidate, true_pose(candidate, problem)).shape == (0, 4, 4)
