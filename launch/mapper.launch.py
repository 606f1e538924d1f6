"""The mapper, started with a robot: parameters, namespace, and enough time to save its map.

    ros2 launch incremental_mapper mapper.launch.py params_file:=my.yaml namespace:=car

Topics are those of the parameters (``lidars.NAME.topic``, ``imu.topic``, ``fix.topic``), or
remapped: ``remappings:="imu:=/sensing/imu fix:=/sensing/gnss/fix"``.
"""

import os
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

ARGUMENTS = {
    'params_file': (
        '',
        'YAML file of parameters, such as "incremental_mapper check --write" makes',
    ),
    'namespace': ('', 'namespace of the node'),
    'name': ('incremental_mapper', 'name of the node'),
    'remappings': ('', 'pairs from:=to, with spaces between them'),
    'save_on_shutdown': ('', 'folder for the map when the node ends; "" leaves it to params_file'),
    'journal_folder': (
        '',
        'folder for journals, against crashes and power cuts; "" leaves it to params_file',
    ),
    'large_clouds': (
        'false',
        'whether this node and what is launched after it have shared memory for whole clouds '
        '(Fast DDS, 134 MB each): it is the driver that needs it, where it publishes best effort',
    ),
    'use_sim_time': ('false', 'whether the node follows /clock'),
    'respawn': ('true', 'whether the node is started again where it ended by itself'),
    'respawn_delay': ('2.0', 'seconds until then'),
    'sigterm_timeout': ('60', 'seconds from SIGINT to SIGTERM: what waits is mapped and saved'),
    'sigkill_timeout': ('60', 'seconds from SIGTERM to SIGKILL'),
    'log_level': ('info', 'debug, info, warn or error'),
}
"""Default and meaning of every argument."""
PROFILE = Path(__file__).parents[1] / 'config' / 'fastdds_large_clouds.xml'
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
"""Variables of Fast DDS, the old and the new one; what a user has set stays."""


def make_node(context):
    """Make the node of the arguments."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    parameters = [given['params_file']] if given['params_file'] else []
    own = {'use_sim_time': given['use_sim_time'].lower() in ('true', '1')}
    if given['save_on_shutdown']:
        own['save.on_shutdown'] = given['save_on_shutdown']
    if given['journal_folder']:
        own['journal.folder'] = given['journal_folder']
    wanted = given['large_clouds'].lower() in ('true', '1')
    room = wanted and not any(os.environ.get(name) for name in PROFILES)
    return [
        *([SetEnvironmentVariable(PROFILES[0], str(PROFILE))] if room else []),
        Node(
            package='incremental_mapper',
            executable='mapper_node',
            name=given['name'],
            namespace=given['namespace'],
            parameters=[*parameters, own],
            remappings=[tuple(pair.split(':=', 1)) for pair in given['remappings'].split()],
            arguments=['--ros-args', '--log-level', given['log_level']],
            output='screen',
            # A wrong parameter ends it at once, and would do so again: two seconds are not a flood.
            respawn=given['respawn'].lower() in ('true', '1'),
            respawn_delay=float(given['respawn_delay']),
            sigterm_timeout=given['sigterm_timeout'],
            sigkill_timeout=given['sigkill_timeout'],
        ),
    ]


def generate_launch_description():
    """Describe what ``ros2 launch`` starts."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=make_node)])
