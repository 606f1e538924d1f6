"""Map, path and graph as they stand while a drive is mapped."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.datasets.open import open_source
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.map.cloud import accumulate
from incremental_mapper.mapping import live_map
from incremental_mapper.mapping.georeferencing import turn_values
from incremental_mapper.mapping.live_map import LiveMap
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.smoothing.correction import Evidence
from incremental_mapper.variables import cluster_of

SECOND = 1_000_000_000


@pytest.fixture(scope='module')
def followed(light_drive):
    """A mapper, what followed it, and the newest graph view after every window."""
    tree = {'mom': {'max_points': 100}, 'path': {'max_poses': 12}, 'graph': {'lag': 0.3}}
    source = open_source(light_drive, tree)
    config = effective_config(source, tree, 'test')
    mapper = Mapper(config, list(source.info.counts))
    live = LiveMap(mapper)
    for measurement in source.measurements():
        for _ in mapper.advance(measurement):
            live.follow()
            assert len(live.path().poses) <= 12
    for _ in mapper.drain():
        live.follow()
    return mapper, live


def test_long_path_is_thinned_and_ends_with_the_newest_pose(followed):
    mapper, live = followed
    path = live.path()
    assert path.stamps == sorted(path.stamps)
    assert path.stamps[-1] == mapper.state.clusters[-1].cluster.stamp
    assert path.stamps[0] == mapper.state.clusters[0].cluster.stamp
    newest = mapper.newest()
    assert path.poses[-1][:3] == pytest.approx(list(newest.pose.translation()))


def test_live_map_is_what_would_be_saved_of_the_same_poses(followed):
    mapper, live = followed
    state, settings = mapper.state, mapper.config.map
    poses = [state.pose(scan.cluster).compose(scan.T_cluster_scan) for scan in state.scans]
    final = [not state.in_lag(scan.cluster) for scan in state.scans]
    placed = [
        (scan.cloud, pose.matrix(), number)
        for number, (scan, pose) in enumerate(zip(state.scans, poses, strict=True))
    ]

    def cells(points):
        floor = np.floor(points[:, :3] / settings.voxel_size).astype(int)
        return [tuple(cell) for cell in floor]

    def saved(chosen):
        return accumulate(chosen, settings.voxel_size, settings.max_range)[0]

    points = live.points()
    before = saved([item for item, done in zip(placed, final, strict=True) if done])
    # What is final comes first and is the saved map; the lag fills voxels that it leaves free.
    assert 1000 < len(before) < len(points)
    shown = dict(zip(cells(points), points[: len(before)], strict=False))
    alone = dict(zip(cells(before), before, strict=True))
    both = sorted(shown.keys() & alone.keys())
    apart = np.abs([shown[cell] - alone[cell] for cell in both]).max(axis=1)
    # A point at a border, within the precision of floats, is in either of two voxels.
    assert (apart < 1e-4).sum() > 0.999 * len(before)
    taken, whole = cells(points), set(cells(saved(placed)))
    assert len(set(taken)) > 0.999 * len(taken)  # a mean at a border rounds to either side
    assert len(whole ^ set(taken)) < 0.001 * len(whole)


def test_increments_have_the_intensities_of_their_scans_from_the_first_one_on(followed):
    mapper, live = followed
    scans = mapper.state.scans[:2]
    made = live.placed(scans)
    light = np.concatenate([scan.cloud[:, 3] for scan in scans])
    assert made.shape[1] == 4 and np.isin(made[:, 3], light).all() and np.ptp(light) > 0.0
    assert live.placed([]).shape == (0, 4)


def test_published_map_is_bounded_by_points_and_radius(followed, monkeypatch):
    mapper, live = followed
    whole = live.points()
    newest = np.array(mapper.newest().pose.translation())

    def bounded(**limits):
        settings = mapper.config.map.model_copy(update=limits)
        monkeypatch.setattr(mapper, 'config', mapper.config.model_copy(update={'map': settings}))
        return live.points()

    def distance(points):
        return np.linalg.norm(points[:, :2] - newest[:2], axis=1)

    everything = bounded(display_points=0, display_radius=0.0)
    assert np.array_equal(np.sort(everything, axis=0), np.sort(whole, axis=0))
    few = bounded(display_points=len(whole) * 3 // 4, display_radius=0.0)
    assert 0.7 * len(whole) < len(few) <= len(whole) * 3 // 4
    assert len(bounded(display_points=100)) <= 100
    near = bounded(display_points=0, display_radius=20.0)
    # What is in the lag is shown in any case.
    assert (distance(whole) <= 19.0).sum() < len(near) < len(whole)


def test_graph_view_holds_the_asked_span_only(followed):
    mapper, live = followed
    newest = mapper.state.frontier.newest_stamp
    within = [c for c in mapper.state.clusters if newest - c.cluster.stamp <= SECOND]
    view = live.graph(1.0)
    assert len(view.poses) == len(within) < len(mapper.state.clusters)
    assert view.edges['odometry'].shape[1:] == (2, 3)
    assert len(live.graph(60.0).poses) == len(mapper.state.clusters)


def test_graph_view_shows_every_span_wherever_its_bias_is(followed):
    mapper, live = followed
    spans = [factor for factor in mapper.state.factors if factor.kind is FactorKind.IMU]
    assert any(len({cluster_of(key) for key in factor.keys}) == 3 for factor in spans)
    edges = live.graph(60.0).edges
    assert len(edges['imu']) == len(spans)
    assert FactorKind.BIAS_RANDOM_WALK not in edges


def test_closed_loops_move_path_and_map_a_part_at_a_time(followed, monkeypatch):
    mapper, _ = followed
    monkeypatch.setattr(live_map, 'AGAIN_SCANS', 3)
    monkeypatch.setattr(live_map, 'AGAIN_POSES', 2)
    live = LiveMap(mapper)
    live.follow()
    state, before, way = mapper.state, live.points(), live.path()
    # As a closure that moves all of the map as one, by more than a voxel.
    T_new_old = gtsam.Pose3(gtsam.Rot3.Yaw(0.1), np.array([3.0, -1.0, 0.0]))
    older, left = (turn_values(values, T_new_old) for values in (state.values, state.prior.values))
    state.hold()
    keys = state.prior.held
    size = state.prior.root.shape[1]
    nothing = Evidence(keys, left.extract(list(keys)), np.zeros((0, size)), np.zeros(0), T_new_old)
    state.close([], nothing, older, left, len(state.clusters), 3.2)
    live.follow()
    assert live.points()[:10] == pytest.approx(before[:10], abs=1e-6)  # not all is placed yet
    for _ in range(len(state.scans)):
        live.follow()
    anew = LiveMap(mapper)
    anew.follow()
    assert live.points() == pytest.approx(anew.points(), abs=1e-5)
    path = live.path()
    assert path.poses == pytest.approx(np.array(anew.path().poses), abs=1e-9)
    assert path.stamps == way.stamps
    expected = T_new_old.transformFrom(np.array(way.poses[0][:3]))
    assert path.poses[0][:3] == pytest.approx(expected, abs=1e-6)
    assert len(live.points()) != len(before) or not np.allclose(live.points(), before, atol=0.1)
