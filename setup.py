"""Packaging for pip and for colcon (build type ament_python)."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'incremental_mapper'
# Not "version = attr:" in setup.cfg: setuptools then prints a line that colcon takes for metadata.
DOOR = Path(__file__).with_name(NAME) / '__init__.py'
VERSION = re.search(r"^__version__ = '(.+)'$", DOOR.read_text(encoding='utf-8'), re.M)[1]
SETTINGS = sorted(str(path) for path in Path('config').iterdir())

SIMULATION = ['embreex>=2.17.7.post4']
REPORT = ['jinja2>=3.1', 'matplotlib>=3.8', 'pyarrow>=14']
FORMATS = ['gpxpy>=1.6', 'laspy[lazrs]>=2.5', 'pyproj>=3.6']
VIEW = ['rerun-sdk>=0.27']
EVALIO = ['evalio>=0.6']
CLUSTER = ['distributed>=2024.1']
CLOSURES = ['map-closures>=2.0']
# GTSAM's wheel needs pytest 9, and Jazzy's launch_testing plugin does not load on 9.1 or later.
TESTS = [
    'pytest==9.0.*',
    'pytest-timeout>=2.3',
    'pytest-xdist>=3.6',
    'hypothesis>=6.100',
    'evo>=1.31',
    'import-linter>=2.1',
    'jsonschema>=4.18',
    'mypy>=1.10',
    'playwright>=1.40',
    'pypcd4>=1.1',
    'ruff>=0.5',
    'trimesh>=4.0',
    'types-PyYAML',
    'types-tqdm',
    *CLUSTER,
    *VIEW,
]
# Everything that the pages need is here: nothing is fetched while they are built or read.
PAGES = [
    'fonttools>=4.40',
    'latex2mathml>=3.77',
    'mkdocs-material>=9.6',
    'mkdocstrings[python]>=0.29',
    'ziamath>=0.12',
]
# A ROS installation provides these itself; the wheels serve machines without one.
ROS = ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces']

setup(
    name=NAME,
    version=VERSION,
    description='Window-by-window selection of the factor graph that makes the best local map',
    author='The incremental_mapper authors',
    license='Apache-2.0',
    license_files=['LICENSE'],
    python_requires='>=3.11',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={
        f'{NAME}.evaluation.report': ['macros.html', 'page.html', 'run.html', 'style.css'],
        f'{NAME}.exports': ['graph.schema.json'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', SETTINGS),
        (f'share/{NAME}/launch', ['launch/mapper.launch.py']),
    ],
    install_requires=[
        'annotated-types>=0.6',
        'gtsam>=4.3',
        'kiss-icp>=1.3',
        'numba>=0.60',
        'numpy>=1.26',
        'pydantic>=2.6',
        'pymap3d>=3.1',
        'pyyaml>=6.0',
        'rosbags>=0.11',
        'scipy>=1.11',
        'small_gicp>=1.0',
        'threadpoolctl>=3.1',
        'tqdm>=4.66',
    ],
    extras_require={
        'ros': ROS,
        'sim': SIMULATION,
        'report': REPORT,
        'formats': FORMATS,
        'view': VIEW,
        'evalio': EVALIO,
        'cluster': CLUSTER,
        'closures': CLOSURES,
        'test': TESTS,
        'docs': PAGES,
    },
    entry_points={
        'console_scripts': [
            f'{NAME} = {NAME}.cli.main:main',
            f'mapper_node = {NAME}.cli.mapper_node:main',
        ]
    },
    zip_safe=False,
)
