"""The node as a program of its own: what keeps it from starting."""

import subprocess

import pytest
import yaml

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from ros_helpers import next_domain

from incremental_mapper.ros.programs import local_environment, node_command


def launch(tmp_path, tree, *arguments):
    path = tmp_path / 'parameters.yaml'
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': tree}}))
    return subprocess.Popen(
        [*node_command([path]), *arguments],
        env=local_environment(next_domain()),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )


@pytest.mark.parametrize(
    ('tree', 'word'),
    [({'window': {'duratoin': 0.2}}, 'duratoin'), ({'map': {'voxel_size': -1.0}}, 'voxel_size')],
)
def test_wrong_parameter_stops_the_node_with_one_line(tmp_path, tree, word):
    process = launch(tmp_path, tree)
    out, err = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert len(err.splitlines()) == 1 and word in err
    assert err.startswith('incremental_mapper: ') and out == ''


def test_damaged_parameter_file_stops_the_node_with_one_line(tmp_path):
    process = launch(tmp_path, {}, '--params-file', str(tmp_path / 'missing.yaml'))
    _, err = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert 'missing.yaml' in err and 'Traceback' not in err
