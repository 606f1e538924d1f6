"""The example that plays a bag into the node, as ``make demo`` runs it."""

import json
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from drive_edits import FILES

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

SCRIPT = Path(__file__).parents[2] / 'examples' / 'play_into_node.py'
SETTINGS = '/**: {ros__parameters: {mom: {max_points: 100}, queue: {core: 3000, max_delay: 0.0}}}\n'


def run_example(*words):
    return subprocess.run(
        [sys.executable, SCRIPT, *map(str, words)], capture_output=True, text=True, timeout=180
    )


def test_tells_whether_the_graphs_are_equal(light_bag, run_map, settings, tmp_path, capsys):
    config, saved = settings(SETTINGS), tmp_path / 'node'
    made_by_map = run_map(light_bag, '--config', config).folder
    done = run_example(light_bag, made_by_map, saved, '--config', config, '--rate', 0.7)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in saved.iterdir()} >= FILES
    lines = done.stdout.splitlines()
    starts = [line.split()[0] for line in lines if not line.startswith(' ')]
    assert starts == ['node', 'player', 'arrived', 'flush', 'client', 'save_map', 'equal']
    assert 'at 0.7 times real time' in done.stdout
    assert [line for line in done.stderr.splitlines() if 'waits ' not in line] == []
    # The same with one cluster a nanosecond later in what map has made.
    graph = json.loads((made_by_map / 'graph.json').read_text())
    graph['clusters'][7]['stamp_ns'] += 1
    (made_by_map / 'graph.json').write_text(json.dumps(graph))
    example = runpy.run_path(str(SCRIPT))
    assert example['tell'](saved, made_by_map) == 1
    assert 'DIFFERENT clusters differ from number 7 on' in capsys.readouterr().out


def test_fails_where_map_has_not_run(light_bag, tmp_path):
    done = run_example(light_bag, tmp_path / 'none', tmp_path / 'node')
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1 and 'run "map" first' in done.stderr


def test_tells_why_the_node_does_not_start(light_bag, run_map, settings, tmp_path):
    done = run_map(light_bag, '--config', settings(SETTINGS))
    config = tmp_path / 'without_ros.yaml'
    config.write_text('mom: {max_points: 100}\n')
    failed = run_example(light_bag, done.folder, tmp_path / 'node', '--config', config)
    assert failed.returncode == 1
    assert 'arguments or parameters cannot be used' in failed.stderr
