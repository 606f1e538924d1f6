"""What `map` says: where it wrote and what to open, its stages, and its help at once."""

import subprocess
import sys

import pytest

from incremental_mapper.cli import map_drive
from incremental_mapper.cli.main import main
from incremental_mapper.cli.progress import Progress
from incremental_mapper.results.offline_run import map_into
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.selection.strategies import BUILT_IN


def test_it_ends_with_where_it_wrote_and_what_to_open(map_light, light_drive):
    run = map_light(light_drive)
    last = run.out.splitlines()[-1]
    assert last == f'written to {run.folder}; open {run.folder / "map.ply"}'
    assert 'done in' in run.out and 'solver error' not in run.out


def test_verbose_has_all_numbers_too(map_light, light_drive):
    run = map_light(light_drive, '--verbose')
    assert 'solver error' in run.out and 'done in' in run.out


def test_a_map_that_is_not_to_be_trusted_is_not_just_there_to_be_opened(tmp_path):
    assert map_drive._where(tmp_path, failed=True).endswith('not to be trusted, see above')


def test_page_comes_first(tmp_path):
    for name in ('map.ply', 'map.png', 'report.html'):
        (tmp_path / name).touch()
        assert map_drive._where(tmp_path, failed=False).endswith(f'open {tmp_path / name}')


def test_stages_are_named_in_their_order(light_drive, tmp_path):
    tree = {'selection': {'strategy': 'min_time_shift'}, 'save': {'pictures': False}}
    stages = []
    map_into(tmp_path, open_drive(light_drive, tree, 'test'), stage=stages.append)
    assert stages == ['last windows', 'final solve', 'map', 'write', 'pictures']


def test_bar_rests_at_its_end_and_begins_anew():
    with Progress(10, hidden=False) as progress:
        bar = progress._bar
        progress.read(7)
        progress.stage('final solve')
        assert (bar.n, bar.desc) == (10, 'final solve: ')
        progress.read(1)  # a setting was mended
        assert (bar.n, bar.desc) == (1, 'map: ')


def test_help_imports_nothing_that_takes_time():
    """It took 3 s; `-X importtime` of the heaviest that is left is a few milliseconds."""
    code = (
        'import sys\nfrom incremental_mapper.cli.main import make_parser\n'
        "make_parser('map').format_help()\n"
        "print([name for name in ('numpy', 'scipy', 'gtsam', 'numba', 'pydantic', 'tqdm') "
        'if name in sys.modules])'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == '[]'


def test_help_knows_the_strategies(capsys):
    assert ', '.join(BUILT_IN) == map_drive.STRATEGIES
    with pytest.raises(SystemExit) as ended:
        main(['map', 'in', 'out', '--strategy', 'nothing'])
    assert ended.value.code == 2
    assert "'nothing' is none of mom, base" in capsys.readouterr().err
