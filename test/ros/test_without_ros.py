"""The programs of this room where there is no ROS: one line, and no traceback."""

import subprocess
import sys

import pytest

HIDDEN = "import sys; sys.modules['rclpy'] = None; "


def run(code):
    return subprocess.run(
        [sys.executable, '-c', HIDDEN + code], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize('module', ['ros.node', 'cli.mapper_node'])
def test_node_says_in_one_line_that_it_needs_ros(module):
    done = run(
        f"import runpy; runpy.run_module('incremental_mapper.{module}', run_name='__main__')"
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and 'needs rclpy' in line and '[ros]' in line
    assert line.count('cannot be imported') == 1


def test_import_of_the_client_says_what_is_missing():
    done = run('from incremental_mapper.ros.client import open_client')
    last = done.stderr.splitlines()[-1]
    assert last.startswith('ImportError: incremental_mapper.ros.client needs rclpy')
