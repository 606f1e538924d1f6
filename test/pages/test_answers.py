"""What the pages promise a newcomer: three answers one click from the start, a true example."""

import re
from pathlib import Path

import settings_page

ROOT = Path(__file__).resolve().parents[2]
START = (ROOT / 'docs' / 'index.md').read_text()
LAYERS = re.search(r'^layers = \[(.*?)^\]', (ROOT / 'pyproject.toml').read_text(), re.M | re.S)


def answer(question: str) -> str:
    """The cell beside a question on the start page."""
    match = re.search(rf'^\| {re.escape(question)} \| (.*) \|$', START, re.M)
    assert match is not None, question
    return match[1]


def test_where_a_cluster_is_merged() -> None:
    cell = answer('Where is a cluster merged?')
    function, file = re.findall(r'`([^`]+)`', cell)
    assert f'def {function.removesuffix("()")}(' in (ROOT / file).read_text()
    name = file.removesuffix('.py').replace('/', '.') + '.' + function.removesuffix('()')
    assert f'](api/candidates.md#{name})' in cell
    assert '](code/layout.md#where-is)' in cell


def test_how_to_add_a_criterion() -> None:
    assert '](extend/criterion.md)' in answer('How do I add a criterion of my own?')
    page = (ROOT / 'docs' / 'extend' / 'criterion.md').read_text()
    example = ROOT / 'examples' / 'my_criterion'
    for language, file in (('python', 'my_criterion.py'), ('toml', 'pyproject.toml')):
        block = re.search(rf'^```{language}\n(.*?)^```', page, re.M | re.S)
        assert block is not None
        lines = (example / file).read_text().splitlines()
        shown = [line for line in block[1].splitlines() if '"""Score of' not in line]
        assert [line for line in shown if line not in lines] == []


def test_what_graph_lag_does() -> None:
    cell = answer('What does `graph.lag` do?')
    assert '](configuration.md#graph.lag)' in cell
    assert '{#graph.lag}' in settings_page.page()
    assert '](tuning.md#the-lag)' in cell
    assert '\n## The lag\n' in (ROOT / 'docs' / 'tuning.md').read_text()


def test_the_floors_are_those_of_the_import_contract() -> None:
    page = (ROOT / 'docs' / 'code' / 'layout.md').read_text()
    floors = re.findall(r'^\| \d+ \| (.*?) \|', page, re.M)
    shown = [set(re.findall(r'`(\w+)`', floor)) for floor in floors]
    assert LAYERS is not None
    layers = [set(re.findall(r'\w+', line)) for line in re.findall(r'"(.*?)"', LAYERS[1])]
    assert shown[:-1] == layers[:-1]
