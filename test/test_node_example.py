"""The example that plays a bag into the node, as ``make demo`` runs it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import FILES

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

SCRIPT = Path(__file__).parent.parent / 'examples' / 'play_into_node.py'
SETTINGS = '/**: {ros__parameters: {mom: {max_points: 100}, queue: {core: 3000}}}\n'


@pytest.fixture
def run_example(light_bag, run_map, settings, tmp_path):
    """Map the light bag, change what ``map`` has made, run the example; returns what it did."""

    def run(change=lambda folder: None):
        config = settings(SETTINGS)
        done = run_map(light_bag, '--config', config)
        change(done.folder)
        words = [light_bag, done.folder, tmp_path / 'node', '--config', config, '--rate', 0.7]
        return subprocess.run(
            [sys.executable, SCRIPT, *map(str, words)], capture_output=True, text=True, timeout=120
        )

    return run


def test_tells_that_the_graphs_are_equal(run_example, tmp_path):
    done = run_example()
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in (tmp_path / 'node').iterdir()} >= FILES
    lines = done.stdout.splitlines()
    starts = [line.split()[0] for line in lines if not line.startswith(' ')]
    assert starts == ['node', 'player', 'arrived', 'flush', 'client', 'save_map', 'equal']
    assert 'at 0.7 times real time' in done.stdout
    assert done.stderr == ''


def test_fails_where_they_are_not(run_example):
    def another_stamp(folder):
        graph = json.loads((folder / 'graph.json').read_text())
        graph['clusters'][7]['stamp_ns'] += 1
        (folder / 'graph.json').write_text(json.dumps(graph))

    done = run_example(another_stamp)
    assert done.returncode == 1
    assert 'DIFFERENT clusters differ from number 7 on' in done.stdout


def test_fails_where_map_has_not_run(light_bag, tmp_path):
    words = [light_bag, tmp_path / 'none', tmp_path / 'node']
    done = subprocess.run(
        [sys.executable, SCRIPT, *map(str, words)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1 and 'run "map" first' in done.stderr


def test_tells_why_the_node_does_not_start(light_bag, run_map, settings, tmp_path):
    done = run_map(light_bag, '--config', settings(SETTINGS))
    config = tmp_path / 'without_ros.yaml'
    config.write_text('mom: {max_points: 100}\n')
    words = [light_bag, done.folder, tmp_path / 'node', '--config', config]
    failed = subprocess.run(
        [sys.executable, SCRIPT, *map(str, words)], capture_output=True, text=True, timeout=60
    )
    assert failed.returncode == 1
    assert 'arguments or parameters cannot be used' in failed.stderr
