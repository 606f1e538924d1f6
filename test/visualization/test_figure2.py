"""The paper's figure 2: the fix is unconnected in the base graph, and not with the method."""

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip('matplotlib', reason='matplotlib is not installed (extra "report")')

SCRIPT = Path(__file__).resolve().parents[2] / 'examples' / 'figure2.py'


@pytest.fixture(scope='module')
def figure2():
    spec = importlib.util.spec_from_file_location('figure2', SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_base_leaves_the_fix_unconnected_and_the_method_does_not(figure2, tmp_path):
    told = figure2.draw(tmp_path / 'figure2.png')
    components, shown = told['base']
    assert components >= 2 and shown.unconnected == 1
    components, shown = told['mom']
    assert components == 1 and shown.unconnected == 0
    assert (tmp_path / 'figure2.png').stat().st_size > 20_000


def test_the_unconnected_variable_is_that_of_the_fix(figure2):
    from incremental_mapper.visualization.graph_view import unconnected_variables

    stats, graph = figure2.run('base')
    unconnected = unconnected_variables(graph)
    owners = {item['cluster'] for item in graph['variables'] if item['key'] in unconnected}
    members = [item['members'] for item in graph['clusters'] if item['id'] in owners]
    assert [[m['sensor'] for m in cluster] for cluster in members] == [['gnss']]
    assert stats['components'] == 1 + len(owners)


def test_no_imu_sample_is_near_the_fix(figure2):
    assert min(abs(stamp - figure2.FIX) for stamp in figure2.imu_stamps()) >= figure2.HOLE
    _, graph = figure2.run('mom')
    assert figure2.companions(graph) in (['left'], ['right'], ['right', 'left'], ['left', 'right'])
