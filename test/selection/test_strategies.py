"""Finding strategies: the paper's own, and those that other packages bring in by entry points."""

import sys

import pytest

from incremental_mapper.config import Strategy
from incremental_mapper.errors import ConfigError
from incremental_mapper.selection.strategies import BUILT_IN, find_strategy, strategy_names

MODULE = """
class Chooser:
    def select(self, problem):
        return None

    def warm_up(self):
        pass

good = Chooser()
number = 3
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Lays packages with entry points on the path, as pip leaves them there."""

    def install(package, **strategies):
        (tmp_path / f'{package}.py').write_text(MODULE)
        facts = tmp_path / f'{package}-1.0.dist-info'
        facts.mkdir()
        (facts / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n')
        lines = [f'{name} = {value}' for name, value in strategies.items()]
        (facts / 'entry_points.txt').write_text(
            '\n'.join(['[incremental_mapper.strategies]', *lines, ''])
        )
        monkeypatch.delitem(sys.modules, package, raising=False)

    monkeypatch.syspath_prepend(tmp_path)
    return install


def test_the_built_in_ones_are_there_without_any_installation():
    assert set(BUILT_IN) == set(Strategy)
    for name in Strategy:
        assert find_strategy(name) is find_strategy(str(name))
    names = ['mom', 'base', 'min_time_shift', 'min_solver_error', 'fewest']
    assert strategy_names()[:5] == names


def test_entry_point_of_another_package_is_found_by_its_name(installed):
    installed('other_a', mine_a='other_a:good')
    assert 'mine_a' in strategy_names()
    import other_a

    assert find_strategy('mine_a') is other_a.good


def test_entry_point_cannot_take_the_place_of_a_strategy_of_the_paper(installed):
    installed('other_b', mom='other_b:good')
    assert find_strategy('mom') is BUILT_IN['mom']
    assert strategy_names().count('mom') == 1


def test_unknown_name_is_refused_with_those_that_are_installed(installed):
    installed('other_c', mine_c='other_c:good')
    with pytest.raises(ConfigError, match=r"'nobody'.*mom, base.*mine_c"):
        find_strategy('nobody')


def test_name_of_two_packages_is_refused_with_both(installed):
    installed('other_d', twice='other_d:good')
    installed('other_e', twice='other_e:good')
    with pytest.raises(ConfigError, match=r'other_d:good and other_e:good.*uninstall'):
        find_strategy('twice')


@pytest.mark.parametrize(
    ('value', 'words'),
    [
        ('{}:good', ['cannot be loaded', 'ModuleNotFoundError']),
        ('other_f:missing', ['cannot be loaded', 'missing']),
        ('other_f:Chooser', ['no object with a method select']),
        ('other_f:number', ['no object with a method select']),
    ],
)
def test_what_is_no_strategy_is_refused_with_its_place(installed, value, words):
    value = value.format('no_such_module')
    installed('other_f', broken=value)
    with pytest.raises(ConfigError) as told:
        find_strategy('broken')
    for word in ['broken', value, *words]:
        assert word in str(told.value)
