"""What the node's program understands itself of its arguments; all else is rclpy's."""

import argparse
from collections.abc import Sequence

from incremental_mapper import __version__


def read_own_arguments(words: Sequence[str]) -> None:
    """Print the help or the version and end the program, where that is asked for.

    Args:
        words: The arguments, without the program's name.
    """
    parser = argparse.ArgumentParser(
        prog='mapper_node',
        usage='%(prog)s [-h] [--version] [--ros-args --params-file YAML -p NAME:=VALUE ...]',
        description='Maps LiDARs, IMU and GNSS live: a ROS 2 node that listens to points_left and '
        'points_right (or whatever lidars.names lists), imu and fix, publishes odometry, path, '
        'map and graph, and logs "listening on ..." once it is ready.',
        epilog='Settings are ROS parameters with the names of the settings files: '
        '--ros-args --params-file config/kaist.yaml -p graph.lag:=5.0. Services: ~/save_map, '
        '~/flush, ~/reset, ~/pause. Everything that is wrong is in the log and on /diagnostics.',
        allow_abbrev=False,
    )
    parser.add_argument('--version', action='version', version=f'%(prog)s {__version__}')
    parser.parse_known_args(_outside_ros_args(words))


def _outside_ros_args(words: Sequence[str]) -> list[str]:
    """The arguments outside of ``--ros-args ... --``."""
    own: list[str] = []
    ours = True
    for word in words:
        if word == '--ros-args':
            ours = False
        elif word == '--' and not ours:
            ours = True
        elif ours:
            own.append(word)
    return own
