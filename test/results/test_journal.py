"""Journals: the map that comes of one is the map that was made, less what was not written."""

import contextlib
import fcntl
import json
import os
import sys
import zlib
from collections import Counter

import numpy as np
import pytest
from full_disk import largest_file

from incremental_mapper.cli.main import main
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.graph import factor_archive
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.georeferencing import without_fixes
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results import offline_run
from incremental_mapper.results.file_names import FILES
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import graph_tree
from incremental_mapper.results.journal.journal_writer import WINDOW, Journal
from incremental_mapper.results.journal.record_file import Record, content, frame, records, title
from incremental_mapper.results.journal.recovered_folder import recover_journal
from incremental_mapper.results.journal.recovery import find_journals, opened, recover
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.settings import merge

QUICK = {'selection': {'strategy': 'min_time_shift'}, 'odometry': {'method': 'gicp'}}
FACTS = InputFacts('here', 'test', {'left': 7}, ('a note',))


class Mapped:
    """A drive that was mapped with a journal, and what is known after every window."""

    def __init__(self, drive, folder, tree=None, between=None):
        source = open_source(drive, QUICK)
        self.config = effective_config(source, merge(QUICK, tree or {}), 'test')
        self.journal = Journal(folder, self.config, FACTS)
        self.mapper = Mapper(self.config, store=self.journal)
        self.sizes = []
        for item in source.measurements():
            self._take(self.mapper.push(item))
            if between is not None:
                between(self.mapper, self.config)
        self._take(self.mapper.flush())
        self.journal.close()
        self.mapper.close()

    def _take(self, windows):
        for window in windows:
            self.journal.window(self.mapper, window, Counter({('left', 'lost'): 3}))
            self.sizes.append(self.journal.nbytes)


@pytest.fixture(scope='module')
def mapped(light_drive, tmp_path_factory):
    return Mapped(light_drive, tmp_path_factory.mktemp('journals'))


@pytest.fixture
def no_pictures(monkeypatch):
    """They take a second; it is as if matplotlib were not installed."""
    monkeypatch.setitem(sys.modules, 'matplotlib', None)


@contextlib.contextmanager
def recovered(path):
    with opened(path, alone=False) as file:
        yield recover(path, file)


def tree_of(result):
    return graph_tree(result.clusters, result.factors, result.values)


def assert_same(result, other, settings):
    assert tree_of(result) == tree_of(other)
    assert np.array_equal(result.trajectory.positions, other.trajectory.positions)
    assert np.array_equal(result.trajectory.stamps, other.trajectory.stamps)
    own, others = (some.cloud(settings) for some in (result, other))
    assert np.array_equal(own.points, others.points) and np.array_equal(own.first, others.first)
    assert np.array_equal(result.fixes, other.fixes)
    assert result.rows == other.rows
    assert json.loads(json.dumps(result.stats)) == other.stats
    assert result.findings == other.findings


def test_recovered_map_is_the_one_that_was_made(mapped):
    with recovered(mapped.journal.path) as found:
        assert_same(mapped.mapper.result(), found.result, mapped.config.map)
        assert found.config == mapped.config
        assert found.drops == Counter({('left', 'lost'): 3})
        assert found.facts.counts == {'left': 7} and found.facts.notes[0] == 'a note'
    assert found.result.statistics.georeferenced, 'the drive tries nothing that is replaced'
    assert len(found.result.clusters) > 20 and len(found.result.fixes) > 0


@pytest.mark.parametrize(('newest', 'block'), [(2048, 64), (8, 4)])
def test_graph_without_fixes_that_proved_wrong_comes_back(
    light_drive, tmp_path, monkeypatch, newest, block
):
    monkeypatch.setattr(factor_archive, 'NEWEST', newest)  # all others are packed
    monkeypatch.setattr(factor_archive, 'BLOCK', block)
    taken = []

    def take_out(mapper, config):
        state = mapper.state
        if not taken and len(state.fixes) > 1:
            taken.append(state.fixes[1].stamp)
            without_fixes(state, config, taken, lambda enu: enu)

    plain = {'graph': {'final_optimization': False}}
    mapped = Mapped(light_drive, tmp_path, plain, take_out)
    assert taken
    with recovered(mapped.journal.path) as found:
        assert_same(mapped.mapper.result(), found.result, mapped.config.map)
        fixes = [one for one in found.result.factors if one.kind is FactorKind.GNSS]
        assert fixes and not any(taken[0] in factor.stamps for factor in fixes)


@pytest.mark.parametrize('share', [0.0, 0.4, 0.999])
def test_journal_that_was_cut_off_lacks_one_window_at_most(mapped, tmp_path, share):
    data = mapped.journal.path.read_bytes()
    before, after = mapped.sizes[-8:-6]
    path = tmp_path / 'cut.journal'
    path.write_bytes(data[: before + round(share * (after - before))])
    with recovered(path) as found:
        assert len(found.result.rows) == len(mapped.sizes) - 7
        assert found.result.stats['components'] == 1
        assert found.findings == ()
        cut = share > 0.0
        assert ('was cut off' in found.notes[0]) == cut


def test_damage_ends_the_map_there_and_is_told(mapped, tmp_path):
    data = bytearray(mapped.journal.path.read_bytes())
    data[mapped.sizes[10] - 5] ^= 1
    path = tmp_path / 'damaged.journal'
    path.write_bytes(data)
    with recovered(path) as found:
        assert len(found.result.rows) == 10
        (finding,) = found.findings
        assert finding.rule == 'journal_damaged' and 'MB' in finding.text


def test_journal_without_a_window_is_no_map(mapped, tmp_path):
    with mapped.journal.path.open('rb') as file:
        found = list(records(mapped.journal.path, file))
    first = next(item for item in found if isinstance(item, Record) and item.kind == WINDOW)
    path = tmp_path / 'early.journal'
    path.write_bytes(mapped.journal.path.read_bytes()[: first.offset])
    with pytest.raises(InputError, match='holds no window of a map'):
        recover_journal(path)
    assert path.exists()


def test_factors_of_another_gtsam_are_refused_in_one_line(mapped, tmp_path):
    path = tmp_path / 'new.journal'
    with mapped.journal.path.open('rb') as file, path.open('wb') as new:
        new.write(title())
        for item in records(path, file):
            data = content(file, item)
            if item.kind == WINDOW:
                data = zlib.compress(zlib.decompress(data).replace(b'::archive', b'::parquet'))
            new.write(frame(item.kind, data))
    with pytest.raises(InputError, match=r'cannot be read by this version .* recover it with'):
        recover_journal(path)


def test_files_are_those_of_a_saved_map(mapped, tmp_path, capsys):
    path = tmp_path / 'drive.journal'
    path.write_bytes(mapped.journal.path.read_bytes())
    words = ['recover', str(tmp_path), '--out', str(tmp_path / 'map'), '--remove']
    assert main([*words, '--no-pictures']) == 0
    printed = capsys.readouterr()
    assert str(tmp_path / 'map') in printed.out and 'recovered from' in printed.err
    assert not path.exists()
    assert set(FILES) <= {file.name for file in (tmp_path / 'map').iterdir()}
    run = FinishedRun(tmp_path / 'map')
    assert run.stats['interrupted'] and run.stats['dropped']['left']['lost'] == 3
    assert run.graph == json.loads(json.dumps(tree_of(mapped.mapper.result())))
    assert len(run.points) == len(mapped.mapper.result().cloud(mapped.config.map))


def test_every_journal_of_a_folder_is_recovered_into_its_own(mapped, tmp_path, capsys):
    for name in ('a', 'b'):
        (tmp_path / f'{name}.journal').write_bytes(mapped.journal.path.read_bytes())
    (tmp_path / 'c.journal').write_bytes(b'something else')
    assert main(['recover', str(tmp_path), '--no-pictures']) == 1
    assert 'c.journal: is no journal' in capsys.readouterr().err
    assert [(tmp_path / name / 'map.ply').exists() for name in ('a', 'b', 'c')] == [
        True,
        True,
        False,
    ]


def test_places_without_a_journal_are_named(tmp_path):
    with pytest.raises(InputError, match='holds no journal'):
        find_journals(tmp_path)
    with pytest.raises(InputError, match='does not exist'):
        find_journals(tmp_path / 'nowhere')


def test_recovery_onto_a_full_disk_leaves_no_half_folder(mapped, tmp_path):
    path = tmp_path / 'drive.journal'
    path.write_bytes(mapped.journal.path.read_bytes())
    with largest_file(100_000), pytest.raises(OutputError, match='cannot be written'):
        recover_journal(path, tmp_path / 'map', remove=True)
    assert [file.name for file in tmp_path.iterdir()] == ['drive.journal']


def test_full_disk_ends_the_journal_and_not_the_map(light_drive, mapped, tmp_path):
    with largest_file(mapped.sizes[-1] // 2):
        half = Mapped(light_drive, tmp_path)
    (finding,) = half.journal.findings
    assert finding.rule == 'journal_ended' and f'{half.journal.missing} windows' in finding.text
    assert half.journal.windows + half.journal.missing == len(mapped.sizes)
    assert half.journal.missing > 3
    assert f'the first {half.journal.windows} windows of the map are' in half.journal.kept()
    # All points are there: those that the journal does not take are kept elsewhere.
    clouds = [run.mapper.result().cloud(run.config.map).points for run in (half, mapped)]
    assert np.array_equal(*clouds)
    with recovered(half.journal.path) as found:
        assert len(found.result.rows) == half.journal.windows


def test_journal_leaves_room_for_the_map(light_drive, tmp_path):
    run = Mapped(light_drive, tmp_path, {'journal': {'reserve': 1e9}})
    (finding,) = run.journal.findings
    assert run.journal.windows == 0 and 'less than journal.reserve' in finding.text


def test_folder_that_cannot_be_made_costs_the_journal_only(light_drive, tmp_path):
    (tmp_path / 'file').write_text('')
    run = Mapped(light_drive, tmp_path / 'file' / 'folder')
    assert [finding.rule for finding in run.journal.findings] == ['journal_ended']
    assert len(run.mapper.result().clusters) > 20
    assert not run.journal.holds_map and run.journal.kept() == ''


def test_journal_in_use_is_left_alone(mapped, tmp_path):
    journal = Journal(tmp_path, mapped.config, FACTS)
    child = os.fork()
    if child == 0:  # a lock counts between processes only
        try:
            recover_journal(journal.path, remove=True)
        except InputError as error:
            os._exit(7 if 'is in use' in str(error) else 1)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert journal.path.exists()
    journal.close()
    assert not journal.path.exists(), 'it holds no map'


def test_copy_of_a_map_that_is_still_being_made_is_told(mapped, tmp_path):
    path = tmp_path / 'drive.journal'
    path.write_bytes(mapped.journal.path.read_bytes())
    with path.open('rb+') as file:
        fcntl.lockf(file, fcntl.LOCK_EX)  # as whoever writes it
        child = os.fork()
        if child == 0:
            run = recover_journal(path, tmp_path / 'copy', pictures=False)
            os._exit(7 if any('still being made' in note for note in run.notes) else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    run = recover_journal(path, tmp_path / 'map', pictures=False)
    assert not any('still being made' in note for note in run.notes)


def test_two_journals_of_one_moment_have_two_files(mapped, tmp_path):
    journals = [Journal(tmp_path, mapped.config, FACTS) for _ in range(2)]
    assert len(list(tmp_path.iterdir())) == 2
    for journal in journals:
        journal.close()


def test_map_removes_its_journal_only_when_all_is_written(
    light_drive, tmp_path, monkeypatch, no_pictures
):
    config = merge(QUICK, {'journal': {'folder': str(tmp_path / 'journals')}})
    offline_run.map_drive(light_drive, tmp_path / 'out', config)
    assert list((tmp_path / 'journals').iterdir()) == []

    def full(*_):
        raise OutputError('map.ply: cannot be written (No space left on device)')

    monkeypatch.setattr(offline_run, 'write_result', full)
    with pytest.raises(OutputError, match=r'No space.* "incremental_mapper recover .*journal"'):
        offline_run.map_drive(light_drive, tmp_path / 'again', config)
    (path,) = (tmp_path / 'journals').iterdir()
    with recovered(path) as found:
        assert len(found.result.clusters) > 20
