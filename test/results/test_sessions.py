"""Sessions: a saved map is read back as it was, and what goes on from it is one map."""

import json
import re
import shutil
import sys
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from drive_edits import LATER, driven_later
from test_journal import Mapped

from incremental_mapper.cli.main import main
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.graph.factors import FactorKind, closure_factor
from incremental_mapper.map.store import MemoryStore
from incremental_mapper.measurements import GnssFix
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import compare_graphs, graph_tree
from incremental_mapper.results.journal.recovered_folder import recover_journal
from incremental_mapper.results.manifest import Manifest
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.results.sessions.going_on import earlier_map
from incremental_mapper.results.sessions.joining import between_datums, joined, turned
from incremental_mapper.results.sessions.merging import merge, read_fleet
from incremental_mapper.results.sessions.saved_run import read_saved_run
from incremental_mapper.results.sessions.session_file import FILE
from incremental_mapper.settings import make_config
from incremental_mapper.settings import merge as settings_merged
from incremental_mapper.variables import pose_key

QUICK = 'selection: {strategy: min_time_shift}\nodometry: {processes: false}\n'
SEOUL = Datum(37.5, 127.0, 30.0)


@pytest.fixture(scope='module')
def two(light_drive, tmp_path_factory):
    """A run, and the map of it and of the same drive a minute later."""
    place = tmp_path_factory.mktemp('sessions')
    later = driven_later(light_drive, place / 'later')
    (place / 'quick.yaml').write_text(QUICK)
    first, both = place / 'first', place / 'both'
    words = ['--config', str(place / 'quick.yaml')]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, 'matplotlib', None)
        assert main(['map', str(light_drive), str(first), *words]) == 0
        assert main(['map', '--continue', str(first), str(later), str(both), *words]) == 0
    return first, both


@pytest.fixture
def copy(two, tmp_path):
    """A copy of the first run to do harm to."""
    return shutil.copytree(two[0], tmp_path / 'run')


def going_on(folder):
    return {'session': {'continue': str(folder)}}


def test_a_saved_run_is_read_back_as_it_was(two):
    first, _ = two
    run = read_saved_run(first, MemoryStore())
    result = run.result
    tree = graph_tree(result.clusters, result.factors, result.values)
    compared = compare_graphs(tree, FinishedRun(first).graph)
    assert compared.differences == () and compared.worst < 1e-12
    stats = FinishedRun(first).stats
    assert run.result.stats == {key: stats[key] for key in run.result.stats}
    assert run.datum == Datum(*stats['datum'])


def test_its_points_make_the_same_map(two):
    first, _ = two
    result = read_saved_run(first, MemoryStore()).result
    config = make_config(FinishedRun(first).stats['settings'])
    cloud, saved = result.cloud(config.map), FinishedRun(first)
    assert len(cloud) == len(saved.points)
    assert np.abs(np.sort(cloud.points[:, :3], 0) - np.sort(saved.points, 0)).max() < 1e-3
    assert np.array_equal(np.sort(cloud.first), np.sort(saved.map.first()))


def test_two_sessions_are_one_map(two):
    first, both = map(FinishedRun, two)
    stats = both.stats
    assert stats['components'] == 1 and stats['georeferenced']
    assert stats['datum'] == first.stats['datum']
    assert [one['joined_by'] for one in stats['sessions']] == ['', 'fixes and closures']
    assert sum(one['clusters'] for one in stats['sessions']) == stats['clusters']
    assert stats['clusters'] > 1.5 * first.stats['clusters']
    assert stats['received']['left'] == 2 * first.stats['received']['left']
    assert len(both.trajectory) == stats['clusters'] == len(both.graph['clusters'])
    assert len(both.windows) == stats['windows'] == sum(s['windows'] for s in stats['sessions'])
    assert [int(row['window']) for row in both.windows] == list(range(stats['windows']))
    assert [item['id'] for item in both.graph['clusters']] == list(range(stats['clusters']))


def test_the_second_session_lies_where_the_first_one_does(two):
    first, both = (FinishedRun(folder).trajectory for folder in two)
    count = len(first)
    again = both.stamps[count:] - LATER
    inside = first.covers(again)
    assert inside.sum() > 10
    apart = both.positions[count:][inside] - first.interpolate(again[inside]).positions
    assert np.linalg.norm(apart, axis=1).max() < 0.1


def test_candidates_and_windows_count_on(two):
    pytest.importorskip('pyarrow')
    first, both = map(FinishedRun, two)
    window = len(first.windows) + 1
    start = both.candidates(window)[0]['start_ns']
    assert start == int(both.windows[window]['start_ns'])


def test_sessions_keep_their_history(two):
    _, both = two
    run = read_saved_run(both, MemoryStore())
    assert len(run.result.sessions) == 2
    assert run.result.sessions[1].joined_by == 'fixes and closures'


def test_a_damaged_folder_is_refused(copy):
    data = bytearray((copy / FILE).read_bytes())
    data[len(data) // 2] ^= 1
    (copy / FILE).write_bytes(data)
    with pytest.raises(InputError, match=rf'{FILE} cannot be trusted'):
        read_saved_run(copy, MemoryStore())


def forge(folder, name, data):
    """Change a file, and its checksum with it, as another version of the program might."""
    (folder / name).write_bytes(data)
    names = json.loads((folder / 'files.json').read_text())['files']
    (folder / 'files.json').write_text(Manifest.of(folder, names).to_text())


def test_another_format_is_refused(copy):
    data = (copy / FILE).read_bytes()
    forge(copy, FILE, data.replace(b'session 1\n', b'session 7\n', 1))
    with pytest.raises(InputError, match='has format 7, this version of the program reads 1'):
        read_saved_run(copy, MemoryStore())


def test_what_this_version_cannot_read_is_refused(copy):
    forge(copy, FILE, (copy / FILE).read_bytes()[:-100])
    with pytest.raises(InputError, match='cannot be read by this version'):
        read_saved_run(copy, MemoryStore())


def test_a_folder_of_an_older_version_is_refused(copy):
    (copy / FILE).unlink()
    tree = json.loads((copy / 'files.json').read_text())
    del tree['files'][FILE]
    (copy / 'files.json').write_text(json.dumps(tree))
    with pytest.raises(InputError, match='an older version wrote it'):
        read_saved_run(copy, MemoryStore())


def test_no_session_goes_on_from_a_map_that_is_nowhere(copy):
    stats = json.loads((copy / 'stats.json').read_text())
    forge(copy, 'stats.json', json.dumps({**stats, 'georeferenced': False}).encode())
    settings = make_config(going_on(copy))
    with pytest.raises(InputError, match='not east-north-up'):
        earlier_map(settings)


def test_a_folder_of_journals_is_told_from_a_run(tmp_path):
    (tmp_path / 'drive_20260101_000000.journal').touch()
    with pytest.raises(InputError, match=r'recover .* makes maps of them'):
        read_saved_run(tmp_path, MemoryStore())


def test_a_session_that_knows_no_place_is_alone_and_not_to_be_trusted(two):
    first, both = two
    settings = make_config(going_on(first))
    earlier = earlier_map(settings)
    result = read_saved_run(both, MemoryStore()).result
    lost = replace(result, statistics=replace(result.statistics, georeferenced=False), sessions=())
    facts = InputFacts('here', 'test', {})
    whole = earlier.map_of_both(lost, settings, facts)
    assert whole.result.clusters == lost.clusters
    assert [one.rule for one in whole.result.findings if one.severity == 'error'] == [
        'session_apart'
    ]


@pytest.mark.parametrize('words', [['--continue', 'RUN', 'DRIVE', 'RUN'], ['DRIVE']])
def test_the_map_before_is_not_written_over(two, light_drive, words, capsys):
    named = {'RUN': str(two[0]), 'DRIVE': str(light_drive)}
    before = (two[0] / 'files.json').read_bytes()
    try:
        status = main(['map', '--force', *(named.get(word, word) for word in words)])
    except SystemExit as ended:
        status = ended.code
    assert status in (1, 2)
    assert 'name another folder' in (err := capsys.readouterr().err) or 'OUT_DIR' in err
    assert (two[0] / 'files.json').read_bytes() == before


def test_frames_of_two_datums_are_of_one_earth():
    rng = np.random.default_rng(5)
    far = SEOUL.geodetic(np.array([9000.0, -7000.0, 40.0]))
    T_seoul_far = between_datums(SEOUL, far)
    for point in rng.uniform(-3000.0, 3000.0, (20, 3)):
        place = far.geodetic(point)
        fix = GnssFix(0, 'gnss', place.latitude, place.longitude, place.altitude, None)
        assert np.allclose(T_seoul_far.transformFrom(point), SEOUL.enu(fix), atol=1e-4)
    assert between_datums(SEOUL, SEOUL).equals(gtsam.Pose3(), 0.0)


def test_a_turned_session_fits_as_well_as_before(two):
    config = make_config({})
    result = read_saved_run(two[0], MemoryStore()).result
    T_other_map = gtsam.Pose3(gtsam.Rot3.Yaw(0.4), np.array([30.0, -20.0, 1.0]))
    moved = turned(result, T_other_map, config)
    for one, other in zip(result.factors, moved.factors, strict=True):
        if one.kind in (FactorKind.GNSS, FactorKind.IMU, FactorKind.ODOMETRY):
            apart = one.factor.error(result.values) - other.factor.error(moved.values)
            assert abs(apart) < 1e-4 * max(one.factor.error(result.values), 1.0)
    pose = result.values.atPose3(pose_key(3))
    assert moved.values.atPose3(pose_key(3)).equals(T_other_map.compose(pose), 1e-9)


def test_ties_pull_sessions_together(two):
    config = make_config({'graph': {'final_optimization': True}})
    part = read_saved_run(two[0], MemoryStore()).result
    count = len(part.clusters)
    keys = (pose_key(2), pose_key(count + 2))
    apart = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, 0.05]))
    tie = closure_factor(keys, apart, np.eye(6) * 1e-4, 0.0, (0, 0))
    both = joined([part, part], config, [tie], 1)
    free = joined([part, part], config)
    assert both.statistics.factors == free.statistics.factors + 1 == len(both.factors)
    assert both.statistics.closures['accepted'] == both.statistics.factors_by_kind['closure'] == 1
    assert [one.joined_by for one in both.sessions] == ['', 'fixes and closures']
    poses = [both.values.atPose3(key) for key in keys]
    assert np.allclose(poses[0].between(poses[1]).translation(), [0.0, 0.0, 0.05], atol=0.02)
    poses = [free.values.atPose3(key) for key in keys]
    assert poses[0].equals(poses[1], 1e-6)


def test_a_tie_that_the_fixes_refute_is_left_out(two):
    config = make_config({'graph': {'final_optimization': True}})
    part = read_saved_run(two[0], MemoryStore()).result
    keys = (pose_key(2), pose_key(len(part.clusters) + 2))
    wrong = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 20.0, 0.0]))
    tie = closure_factor(keys, wrong, np.eye(6) * 1e-4, 3.0, (0, 0))
    both = joined([part, part], config, [tie], 1)
    assert both.statistics.closures['accepted'] == 0
    assert len(both.factors) == both.statistics.factors == 2 * len(part.factors)
    poses = [both.values.atPose3(key) for key in keys]
    assert poses[0].equals(poses[1], 1e-4)


def test_merged_runs_are_one_map(two, light_drive, tmp_path):
    first, _ = two
    beside = driven_later(light_drive, tmp_path / 'beside', by=123_456_789)
    (tmp_path / 'quick.yaml').write_text(QUICK)
    second = tmp_path / 'second'
    assert main(['map', str(beside), str(second), '--config', str(tmp_path / 'quick.yaml')]) == 0
    done = merge(read_fleet([first, second]))
    one, other = FinishedRun(first).stats, FinishedRun(second).stats
    assert done.result.statistics.components == 1
    assert done.result.statistics.clusters == one['clusters'] + other['clusters']
    assert [session.joined_by for session in done.result.sessions] == ['', 'fixes']
    assert any('overlap in time' in note for note in done.statistics.input.notes)


def test_a_drive_enters_a_joint_map_once(two, copy):
    first, both = two
    for again in (copy, both):  # a copy of the folder, and a map that has the drive in it
        with pytest.raises(InputError, match=r'is the same drive as .*/first \(\d+ fixes'):
            read_fleet([first, again])


def test_a_drive_that_is_gone_on_with_itself_is_an_error(two, light_drive, tmp_path, capsys):
    (tmp_path / 'quick.yaml').write_text(QUICK)
    words = ['--config', str(tmp_path / 'quick.yaml')]
    out = tmp_path / 'again'
    assert main(['map', '--continue', str(two[0]), str(light_drive), str(out), *words]) == 1
    assert 'session_repeated' in capsys.readouterr().err
    stats, before = FinishedRun(out).stats, FinishedRun(two[0]).stats
    assert stats['clusters'] == before['clusters'] and not stats.get('sessions')


def test_settings_that_fix_another_datum_are_refused(two):
    place = FinishedRun(two[0]).stats['datum']
    own = dict(zip(('latitude', 'longitude', 'altitude'), place, strict=True))
    same = {**going_on(two[0]), 'datum': {'fixed': True, **own}}
    assert earlier_map(make_config(same)).datum == Datum(*place)
    other = settings_merged(same, {'datum': {'latitude': 48.0}})
    with pytest.raises(ConfigError, match='leave the datum out, or begin another map'):
        earlier_map(make_config(other))


def test_runs_that_cannot_be_related_are_refused(two, copy):
    first, _ = two
    with pytest.raises(ConfigError, match='named twice'):
        read_fleet([first, first])
    with pytest.raises(ConfigError, match='the only run'):
        read_fleet([first])
    stats = json.loads((copy / 'stats.json').read_text())
    far = {**stats, 'datum': [stats['datum'][0] + 1.0, *stats['datum'][1:]]}
    for changed, word in (
        ({**stats, 'georeferenced': False}, 'not east-north-up'),
        ({**stats, 'components': 2}, 'in 2 pieces'),
        (far, 'km from'),
    ):
        forge(copy, 'stats.json', json.dumps(changed).encode())
        with pytest.raises(InputError, match=word):
            read_fleet([first, copy])


def test_fixes_that_contradict_what_both_show_are_an_error(two):
    settings = make_config(going_on(two[0]))
    earlier = earlier_map(settings)
    part = earlier.run.result
    # As by a receiver with another reference station: the whole session, fixes and all, 2 m off.
    aside = turned(part, gtsam.Pose3(gtsam.Rot3(), np.array([1.2, 1.6, 0.0])), settings)
    whole = earlier.map_of_both(aside, settings, InputFacts('here', 'test', {}))
    (found,) = [one for one in whole.result.findings if one.rule == 'sessions_disagree']
    metres = float(re.search(r'lies ([\d.]+) m apart', found.text)[1])
    assert found.severity == 'error' and metres == pytest.approx(2.0, abs=0.2)
    assert whole.result.sessions[1].joined_by == 'fixes'


def test_a_session_that_was_cut_off_is_recovered_with_the_one_before(two, copy, tmp_path):
    later = two[0].parent / 'later'
    earlier = earlier_map(make_config(going_on(copy)))
    tree = settings_merged(going_on(copy), earlier.settings)
    mapped = Mapped(later, tmp_path / 'journals', tree)
    path = tmp_path / 'cut.journal'
    # The power goes while the last window is written.
    path.write_bytes(mapped.journal.path.read_bytes()[: mapped.sizes[-2] + 10])
    run = recover_journal(path, tmp_path / 'map', pictures=False)
    stats, before = FinishedRun(run.folder).stats, FinishedRun(copy).stats
    assert stats['components'] == 1 and stats['interrupted']
    assert stats['sessions'][0]['clusters'] == before['clusters']
    assert stats['sessions'][1]['windows'] == len(mapped.sizes) - 1
    assert stats['datum'] == before['datum']
    # Without the map before there is the session alone, in the frame of both.
    shutil.rmtree(copy)
    alone = FinishedRun(recover_journal(path, tmp_path / 'alone', pictures=False).folder)
    assert [one['rule'] for one in alone.stats['warnings']].count('session_lost') == 1
    assert alone.stats['clusters'] == stats['clusters'] - before['clusters']
    assert alone.stats['datum'] == before['datum']
