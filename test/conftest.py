"""Simulated drives that the end-to-end tests share, and a way to run the ``map`` command."""

import csv
import json
import shutil
import signal
import sys
import warnings
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from drive_edits import FILES, cut_drive
from hypothesis import settings as hypothesis_settings

from incremental_mapper.cli.convert import convert
from incremental_mapper.cli.main import main
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.trajectory import read_tum

UNCOUNTED = {'bad_line', 'bad_name'}
"""Reasons of lines and files that never were a measurement, which inputs do not announce."""
LIGHT_SECONDS = 2.3

# Under nohup, or in the background of a script, Ctrl-C is ignored, and would be in every program
# that a test starts. A handler is not inherited: programs start with what is usual.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples in every run: what fails fails again.
hypothesis_settings.register_profile('same', derandomize=True, database=None)
hypothesis_settings.load_profile('same')


@dataclass(frozen=True)
class MapRun:
    """What one ``map`` command did: exit status, what it printed, and its output folder."""

    status: int
    out: str
    err: str
    folder: Path

    def text(self, name):
        return (self.folder / name).read_text(encoding='utf-8')

    @cached_property
    def stats(self):
        return json.loads(self.text('stats.json'))

    @cached_property
    def graph(self):
        return json.loads(self.text('graph.json'))

    @cached_property
    def trajectory(self):
        return read_tum(self.folder / 'trajectory.tum')

    @cached_property
    def rows(self):
        return list(csv.DictReader(self.text('windows.csv').splitlines()))

    def factors(self, kind):
        return [factor for factor in self.graph['factors'] if factor['kind'] == kind]

    def used(self, sensor):
        """Stamps of the sensor's measurements that are in the graph.

        A fix that later ones refuted leaves its cluster's pose behind, and no factor.
        """
        held = ([*item['members'], *item.get('joined', ())] for item in self.graph['clusters'])
        members = (member for members in held for member in members)
        fixes = {factor['stamps_ns'][0] for factor in self.factors('gnss')}
        return sorted(
            item['stamp_ns']
            for item in members
            if item['sensor'] == sensor and (item['kind'] != 'gnss' or item['stamp_ns'] in fixes)
        )

    def assert_refused(self, *words):
        """Exit status 1, one line on stderr that holds ``words``, and no output."""
        assert self.status == 1
        assert 'Traceback' not in self.err
        lines = [line for line in self.err.splitlines() if not line.startswith('note: ')]
        assert len(lines) == 1, self.err
        assert lines[0].startswith('incremental_mapper: ')
        for word in words:
            assert word in lines[0]
        assert not FILES & set(self.names())

    def names(self):
        return sorted(path.name for path in self.folder.iterdir()) if self.folder.is_dir() else []

    def assert_sound(self):
        """All files are there, finite, and tell the same story; every measurement is in one."""
        assert 'Traceback' not in self.err and 'Warning' not in self.err
        assert set(self.names()) >= FILES
        assert not [name for name in self.names() if 'partial' in name]
        stats, graph = self.stats, self.graph
        keys = [variable['key'] for variable in graph['variables']]
        assert len(set(keys)) == len(keys) == stats['vertices']
        assert all({*factor['variables']} <= {*keys} for factor in graph['factors'])
        values = [number for variable in graph['variables'] for number in variable['value']]
        assert np.isfinite(values).all()
        assert len(graph['factors']) == stats['factors']
        assert len(graph['clusters']) == stats['clusters']
        assert len(self.trajectory) == stats['clusters'] + stats['standing_windows']
        assert len(self.rows) == stats['windows']
        for sensor, count in stats['input']['counts'].items():
            if sensor != 'imu':
                reasons = stats['dropped'].get(sensor, {})
                dropped = sum(reasons[reason] for reason in reasons.keys() - UNCOUNTED)
                assert len(self.used(sensor)) + dropped == count, sensor
        assert stats['unused_measurements'] == 0


@pytest.fixture
def run_map(tmp_path, capsys):
    """Run ``map INPUT OUT [options]`` in this process; a finished run is checked to be sound.

    ``pictures=False`` spares the second that they take, as if matplotlib were not installed.
    """

    def run(source, *options, out=None, pictures=False):
        folder = tmp_path / 'out' if out is None else out
        with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
            warnings.simplefilter('error', RuntimeWarning)  # a user would see it on stderr
            if not pictures:
                patch.setitem(sys.modules, 'matplotlib', None)
            capsys.readouterr()
            status = main(['map', str(source), str(folder), *map(str, options)])
        printed = capsys.readouterr()
        done = MapRun(status, printed.out, printed.err, folder)
        if status == 0:
            done.assert_sound()
        return done

    return run


@pytest.fixture
def map_light(run_map, settings):
    """As ``run_map``, with a quick strategy unless one is given; ``config`` is added to that."""

    def run(source, *options, config='', strategy='min_solver_error', **choices):
        path = settings('mom:\n  max_points: 100\n' + config)
        words = ('--strategy', strategy, '--config', path)
        return run_map(source, *options, *words, **choices)

    return run


@pytest.fixture
def settings(tmp_path):
    """Write a settings file of the given text; returns its path."""

    def write(text):
        path = tmp_path / 'settings.yaml'
        path.write_text(text)
        return path

    return write


@pytest.fixture(scope='session')
def drive(tmp_path_factory):
    """A KAIST folder of 3 s at constant speed, four fixes; not to be written to."""
    if find_spec('embreex') is None:
        pytest.skip('embreex is not installed (extra "sim")')
    folder = tmp_path_factory.mktemp('drives') / 'drive'
    simulate(folder, SimulationOptions(motion=MotionKind.CONST, duration=3.0, seed=3))
    return folder


@pytest.fixture(scope='session')
def light_drive(drive, tmp_path_factory):
    """The first 2.3 s of ``drive`` with every fifth point: quick; not to be written to."""
    folder = tmp_path_factory.mktemp('drives') / 'light'
    shutil.copytree(drive, folder)
    cut_drive(folder, LIGHT_SECONDS, every=5)
    return folder


@pytest.fixture
def light_copy(light_drive, tmp_path):
    """A copy of ``light_drive`` to do harm to."""
    return shutil.copytree(light_drive, tmp_path / 'light')


@pytest.fixture(scope='session')
def bag(drive, tmp_path_factory):
    """``drive`` as a bag, by the ``convert`` command; not to be written to."""
    folder = tmp_path_factory.mktemp('bags') / 'bag'
    convert(drive, folder)
    return folder


@pytest.fixture(scope='session')
def light_bag(light_drive, tmp_path_factory):
    """``light_drive`` as a bag; not to be written to."""
    folder = tmp_path_factory.mktemp('bags') / 'light'
    convert(light_drive, folder)
    return folder


@pytest.fixture(scope='session')
def messages(light_bag):
    """The sensors' messages of ``light_bag`` in the order in which they were logged."""
    from ros_helpers import read_inputs

    return read_inputs(light_bag)


@pytest.fixture
def start_node(tmp_path, light_bag):
    """Start a node in this process, with ``trees`` laid over the settings of ``light_bag``.

    It saves into ``tmp_path / 'saved'``, without pictures, and is closed in the end.
    """
    from ros_helpers import NodeSession, bag_parameters

    sessions = []

    def start(*trees):
        saving = {'save': {'folder': str(tmp_path / 'saved'), 'pictures': False}}
        sessions.append(NodeSession(tmp_path, bag_parameters(light_bag, saving, *trees)))
        return sessions[-1]

    yield start
    for session in sessions:
        session.close()
