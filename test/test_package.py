"""What packagers read: package.xml names what is imported, the launch file starts the node."""

import ast
import importlib.util
import re
import sys
import types
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest

from incremental_mapper import __version__ as VERSION  # noqa: N812

ROOT = Path(__file__).parents[1]
LAUNCH = ROOT / 'launch' / 'mapper.launch.py'
NAME = 'incremental_mapper'
PACKAGES = {
    'PIL': 'matplotlib',
    'mpl_toolkits': 'matplotlib',
    'yaml': 'pyyaml',
    'annotated_types': 'annotated-types',
    'kiss_icp': 'kiss-icp',
    'rerun': 'rerun-sdk',
}
"""Distributions that are not called as their modules are."""
KEYS = {
    'numpy': 'python3-numpy',
    'pydantic': 'python3-pydantic',
    'pyyaml': 'python3-yaml',
    'scipy': 'python3-scipy',
    'tqdm': 'python3-tqdm',
    'matplotlib': 'python3-matplotlib',
    'jinja2': 'python3-jinja2',
}
"""rosdep's keys of distributions that have one; the others come from PyPI."""
HAS_LAUNCH = importlib.util.find_spec('launch_ros') is not None
"""Not so among the wheels of PyPI."""


@cache
def imported():
    """Top names of what the package imports and neither is nor comes with Python."""
    found = set()
    for path in (ROOT / NAME).rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split('.')[0])
    return found - sys.stdlib_module_names - {NAME}


def declared(kind):
    root = ElementTree.parse(ROOT / 'package.xml').getroot()
    return {element.text for element in root.findall(kind)}


def from_pypi():
    """Distributions that setup.py names, extras included."""
    text = (ROOT / 'setup.py').read_text(encoding='utf-8')
    words = [
        node.value
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return {re.split(r'[=><!~\[;]', word)[0] for word in words}


def is_ros(name):
    return name in {'rclpy', 'builtin_interfaces', 'rcl_interfaces'} or name.endswith(
        ('_msgs', '_srvs')
    )


def test_package_xml_names_every_ros_package_that_is_imported_and_no_other():
    ros = {name for name in imported() if is_ros(name)}
    assert ros - declared('exec_depend') == set()
    others = {name for name in declared('exec_depend') if not name.startswith('python3-')}
    assert others - ros - {'launch', 'launch_ros', 'ros2launch'} == set()


def test_setup_py_names_every_library_that_is_imported():
    libraries = {PACKAGES.get(name, name) for name in imported() if not is_ros(name)}
    assert libraries - from_pypi() == set()


def test_package_xml_names_the_key_of_every_library_that_has_one():
    libraries = {PACKAGES.get(name, name) for name in imported() if not is_ros(name)}
    keys = {KEYS[name] for name in libraries if name in KEYS}
    named = {name for name in declared('exec_depend') if name.startswith('python3-')}
    assert named == keys


def test_versions_of_package_xml_and_of_the_package_are_one():
    assert ElementTree.parse(ROOT / 'package.xml').findtext('version') == VERSION


def test_setup_py_installs_the_launch_file_and_every_file_of_settings():
    text = (ROOT / 'setup.py').read_text(encoding='utf-8')
    assert all(f"'launch/{path.name}'" in text for path in LAUNCH.parent.glob('*.py'))


class Made:
    """Stands for a class of ``launch``: keeps what it was made of."""

    def __init__(self, *given, **named):
        self.given, self.named = given, named

    def perform(self, context):
        return context[self.given[0]]


@pytest.fixture
def launched(monkeypatch):
    """The launch file, with stand-ins for launch where that is not installed, as on PyPI."""
    if not HAS_LAUNCH:
        for module, names in {
            'launch': ['LaunchDescription'],
            'launch.actions': [
                'DeclareLaunchArgument',
                'OpaqueFunction',
                'SetEnvironmentVariable',
            ],
            'launch.substitutions': ['LaunchConfiguration'],
            'launch_ros': [],
            'launch_ros.actions': ['Node'],
        }.items():
            made = types.ModuleType(module)
            for name in names:
                setattr(made, name, type(name, (Made,), {}))
            monkeypatch.setitem(sys.modules, module, made)
    space = {'__file__': str(LAUNCH)}
    exec(compile(LAUNCH.read_text(encoding='utf-8'), str(LAUNCH), 'exec'), space)
    return space


def test_launch_file_describes_the_node_and_its_arguments(launched):
    if HAS_LAUNCH:
        assert launched['generate_launch_description']().entities
        return
    description = launched['generate_launch_description']()
    *arguments, function = description.given[0]
    assert {item.given[0] for item in arguments} == set(launched['ARGUMENTS'])
    defaults = {item.given[0]: item.named['default_value'] for item in arguments}
    assert all(isinstance(value, str) for value in defaults.values())
    given = defaults | {
        'params_file': 'my.yaml',
        'namespace': 'car',
        'remappings': 'imu:=/sensing/imu fix:=/gnss/fix',
        'save_on_shutdown': '/maps/today',
        'journal_folder': '/maps/journals',
    }
    (node,) = function.named['function'](given)
    assert node.named['package'] == NAME and node.named['executable'] == 'mapper_node'
    assert node.named['namespace'] == 'car'
    assert node.named['parameters'] == [
        'my.yaml',
        {
            'use_sim_time': False,
            'save.on_shutdown': '/maps/today',
            'journal.folder': '/maps/journals',
        },
    ]
    assert node.named['remappings'] == [('imu', '/sensing/imu'), ('fix', '/gnss/fix')]
    assert node.named['respawn'] is True
    # ros2 launch waits 5 s by default: less than a map takes to be saved.
    assert float(node.named['sigterm_timeout']) >= 30 <= float(node.named['sigkill_timeout'])


def test_launch_file_gives_room_for_large_clouds_where_the_user_has_set_nothing(
    launched, monkeypatch
):
    if HAS_LAUNCH:
        pytest.skip('stand-ins are looked at')
    for name in launched['PROFILES']:
        monkeypatch.delenv(name, raising=False)
    *arguments, function = launched['generate_launch_description']().given[0]
    given = {item.given[0]: item.named['default_value'] for item in arguments}
    assert len(function.named['function'](given)) == 1
    given['large_clouds'] = 'true'
    variable, _ = function.named['function'](given)
    name, path = variable.given
    assert name == 'FASTRTPS_DEFAULT_PROFILES_FILE' and Path(path).is_file()
    monkeypatch.setenv('FASTDDS_DEFAULT_PROFILES_FILE', '/mine.xml')
    assert len(function.named['function'](given)) == 1


def test_colcon_lines_of_the_pages_are_those_that_ci_runs():
    page = (ROOT / 'docs' / 'quickstart.md').read_text(encoding='utf-8')
    script = (ROOT / '.ci' / 'colcon').read_text(encoding='utf-8')
    lines = [line for line in page.splitlines() if line.startswith('python -m colcon ')]
    assert len(lines) == 3
    ran = {line.strip().removeprefix('works ') for line in script.splitlines()}
    assert set(lines) <= ran
    assert '.ci/colcon' in (ROOT / 'Makefile').read_text(encoding='utf-8')
    assert 'make colcon' in (ROOT / '.ci' / 'run').read_text(encoding='utf-8')
