"""The example of a criterion of one's own, installed as a package of its own."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'my_criterion'
NAME = 'penalised_error'


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    """A folder into which pip has installed the example, and nothing else."""
    scratch = tmp_path_factory.mktemp('own')
    # Building leaves files beside the source.
    source = shutil.copytree(EXAMPLE, scratch / 'source')
    command = ['pip', 'install', '--quiet', '--no-deps', '--target', scratch / 'site', source]
    done = subprocess.run(
        [sys.executable, '-m', *map(str, command)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return scratch / 'site'


def call(site, *words):
    done = subprocess.run(
        [sys.executable, '-m', 'incremental_mapper.cli.main', *map(str, words)],
        env={**os.environ, 'PYTHONPATH': os.pathsep.join([str(site), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_map_judges_by_it_and_pays_for_variables(site, light_drive, tmp_path):
    call(site, 'map', light_drive, tmp_path / 'own', '--strategy', NAME)
    call(site, 'map', light_drive, tmp_path / 'plain', '--strategy', 'min_solver_error')
    own, plain = (
        json.loads((tmp_path / name / 'stats.json').read_text()) for name in ('own', 'plain')
    )
    assert own['strategy'] == NAME
    assert own['selection.score'] == {NAME: own['windows']}
    assert own['components'] == 1
    assert own['vertices'] < plain['vertices']


def test_evaluate_puts_it_into_the_table(site, light_drive, tmp_path):
    printed = call(
        site, 'evaluate', light_drive, '--out', tmp_path / 'out', '--strategies', f'base,{NAME}'
    )
    assert NAME.split('_')[0] in printed  # its column's title is broken into lines
    assert NAME in (tmp_path / 'out' / 'table.csv').read_text()
    assert (tmp_path / 'out' / 'light' / NAME / 'graph.json').is_file()


def test_node_judges_by_it(site, start_node, messages, monkeypatch):
    monkeypatch.syspath_prepend(site)
    session = start_node({'selection': {'strategy': NAME}})
    session.play(messages)
    stats = session.finish()
    assert stats['strategy'] == NAME
    assert stats['selection.score'] == {NAME: stats['windows']}
