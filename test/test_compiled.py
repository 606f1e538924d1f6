"""Compiled kernels: what they may call, what is compiled beforehand, and where the code is kept."""

import importlib
import os
import pkgutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

import incremental_mapper.map as map_package
from incremental_mapper import compiled, scoring, smoothing
from incremental_mapper.compiled import kernel

MODULES = [
    importlib.import_module(f'{package.__name__}.{item.name}')
    for package in (scoring, smoothing, map_package)
    for item in pkgutil.iter_modules(package.__path__)
]
KERNELS = [
    item
    for module in MODULES
    for item in vars(module).values()
    if isinstance(item, Dispatcher) and item.py_func.__module__ == module.__name__
]
LOADED = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_compiled
from incremental_mapper import Config, Mapper
def types():
    return [(item.py_func.__name__, item.signatures) for item in test_compiled.KERNELS]
Mapper(Config()).close()
before = types()
"""
COUNT_MISSES = """
stats = [item.stats for item in test_compiled.KERNELS]
for counts in zip(*[(stat.cache_hits.total(), stat.cache_misses.total()) for stat in stats]):
    print(sum(counts))
"""


def run(program, before='', **environment):
    """What a process of its own prints, where nothing else has been compiled."""
    package = Path(scoring.__path__[0]).parents[1]
    done = subprocess.run(
        [sys.executable, '-c', before + textwrap.dedent(program)],
        env={**os.environ, 'PYTHONPATH': str(package), **environment},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_there_are_kernels():
    assert len(KERNELS) > 10


@pytest.mark.parametrize('item', KERNELS, ids=lambda item: item.py_func.__name__)
def test_kernel_uses_its_own_file_only(item):
    # The code on disk would not be made anew when another file changes.
    own = item.py_func.__module__
    for name in set(item.py_func.__code__.co_names):
        value = item.py_func.__globals__.get(name)
        if isinstance(value, Dispatcher):
            assert value.py_func.__module__ == own, name
        elif isinstance(value, int | float):
            assert f'\n{name} = ' in Path(item.py_func.__code__.co_filename).read_text(), name


def test_window_finds_everything_compiled():
    program = """
        import room_scene
        from incremental_mapper.scoring.mom import choose_query_points, fast_scores
        local_map = room_scene.jittered(room_scene.room_scene(1), 5, 0.05, 1e-3)
        for given in (local_map, room_scene.with_candidates(local_map)):
            given.poses.flags.writeable = given.origin.flags.writeable = False
            query_points = choose_query_points(given, room_scene.SETTINGS)
            fast_scores(query_points, given.poses, given, room_scene.SETTINGS)
            fast_scores(query_points, given.poses[1:2], given, room_scene.SETTINGS, exact=False)
        print(types() == before, sum(len(some) for _, some in before))
    """
    same, compiled = run(program, before=LOADED).split()
    assert same == 'True'
    assert int(compiled) > 8


def test_drive_finds_everything_compiled(light_drive):
    program = f"""
        from pathlib import Path
        from incremental_mapper.datasets.open import open_source
        from incremental_mapper.results.opened_drive import effective_config
        from incremental_mapper.mapping.mapper import Mapper
        source = open_source(Path({str(light_drive)!r}))
        config = effective_config(source, {{'odometry': {{'processes': False}}}}, 'settings')
        mapper = Mapper(config)
        windows = [window for item in source.measurements() for window in mapper.push(item)]
        print(types() == before, mapper.stats()['candidates_solved'])
    """
    same, solved = run(program, before=LOADED).split()
    assert same == 'True'
    assert int(solved) > 20


def test_search_for_loops_finds_everything_compiled():
    program = """
        import gtsam
        from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
        from incremental_mapper.variables import pose_key
        values = gtsam.Values()
        for number in range(2):
            values.insert(pose_key(number), gtsam.Pose3())
        noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
        step = gtsam.BetweenFactorPose3(pose_key(0), pose_key(1), gtsam.Pose3(), noise)
        RelativeCovariances([step], values).relative(pose_key(0), pose_key(1))
        print(types() == before)
    """
    assert run(program, before=LOADED).split() == ['True']


def test_code_is_kept_where_the_user_says(tmp_path):
    def count():
        return map(int, run(COUNT_MISSES, before=LOADED, NUMBA_CACHE_DIR=str(tmp_path)).split())

    found, made_anew = count()
    assert found == 0 < made_anew
    assert list(tmp_path.rglob('*.nbc'))
    found, made_anew = count()
    assert found > 0 == made_anew


def made():
    @kernel
    def total(values):
        found = 0.0
        for value in values:
            found += value
        return found

    return total


def test_kernel_works_where_no_folder_can_be_written_to(monkeypatch):
    monkeypatch.setattr(FunctionCache._impl_class, '_locator_classes', [])
    assert made()(np.arange(4.0)) == 6.0


def test_kernel_works_where_the_disk_is_full(monkeypatch):
    asked = []

    def full(*args):
        asked.append(args)
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(FunctionCache, 'save_overload', full)
    monkeypatch.setattr(FunctionCache, 'load_overload', lambda *_: None)
    assert made()(np.arange(4.0)) == 6.0
    assert asked


@pytest.mark.parametrize(('patience', 'told'), [(0.0, 1), (60.0, 0)])
def test_who_waits_for_the_compiler_is_told(monkeypatch, caplog, patience, told):
    monkeypatch.setattr(compiled, 'LONG', patience)
    with compiled.waiting():
        until = time.monotonic() + 10.0
        while told and not caplog.records and time.monotonic() < until:
            time.sleep(0.01)
    assert [record.getMessage()[:9] for record in caplog.records] == ['compiling'] * told
