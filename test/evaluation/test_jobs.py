"""The jobs of an evaluation: names of sequences, and a job for each strategy."""

from pathlib import Path

import pytest

from incremental_mapper.errors import ConfigError
from incremental_mapper.evaluation.jobs import plan_jobs, sequence_names


@pytest.mark.parametrize(
    ('paths', 'names'),
    [
        (['/data/urban26', '/data/urban33'], ['urban26', 'urban33']),
        (['/a/drive', '/b/drive', '/b/other'], ['a_drive', 'b_drive', 'other']),
        (['/x/a/drive', '/y/a/drive'], ['x_a_drive', 'y_a_drive']),
        (['/a_b/c', '/a/b_c', '/c'], None),
        (['/a/c', '/a_c', '/c'], None),
        (['/'], ['input']),
    ],
)
def test_sequences_have_names_of_their_own(paths, names):
    found = sequence_names([Path(path) for path in paths])
    assert len(set(found)) == len(paths)
    assert all(name and '/' not in name for name in found)
    assert names is None or found == names


def test_file_and_folder_of_one_name_are_told_apart(tmp_path):
    (tmp_path / 'drive').mkdir()
    (tmp_path / 'drive.mcap').touch()
    (tmp_path / 'drive.bag').touch()
    names = sequence_names([tmp_path / 'drive', tmp_path / 'drive.mcap', tmp_path / 'drive.bag'])
    assert len(set(names)) == 3
    assert sequence_names([tmp_path / 'drive.mcap']) == ['drive']


def test_input_given_twice_is_one_sequence(tmp_path):
    drive = tmp_path / 'drive'
    drive.mkdir()
    twice = [drive, tmp_path / '.' / 'drive' / '..' / 'drive']
    jobs = plan_jobs(twice, tmp_path / 'out', ['base', 'mom'], {}, 'settings')
    assert [(job.sequence, job.strategy) for job in jobs] == [('drive', 'base'), ('drive', 'mom')]
    assert all(job.folder.is_absolute() for job in jobs)


def test_a_confidence_behind_the_name_makes_a_job_of_its_own(tmp_path):
    labels = ['mom', 'mom@0', 'mom@0.5']
    jobs = plan_jobs([tmp_path], tmp_path / 'out', labels, {'mom': {'radius': 2.0}}, 'settings')
    assert [job.strategy for job in jobs] == labels
    assert len({job.key for job in jobs}) == len({job.folder for job in jobs}) == 3
    chosen = [job.tree['selection'] for job in jobs]
    assert chosen[0] == {'strategy': 'mom'}
    assert chosen[2] == {'strategy': 'mom', 'tie_confidence': 0.5}
    assert all(job.tree['mom'] == {'radius': 2.0} for job in jobs)


@pytest.mark.parametrize('label', ['mom@', 'mom@much', 'mom@0.5@0.6'])
def test_what_is_no_confidence_is_refused(label, tmp_path):
    with pytest.raises(ConfigError, match='is no confidence such as'):
        plan_jobs([tmp_path], tmp_path / 'out', [label], {}, 'settings')
