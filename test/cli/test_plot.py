"""``plot`` draws single pictures of a finished run in three formats."""

import shutil

import numpy as np
import pytest

from incremental_mapper.cli.main import main
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import write_tum

REASON = 'matplotlib is not installed; pictures need the extra "report"'
image = pytest.importorskip('matplotlib.image', reason=REASON)


@pytest.fixture(scope='module')
def folder(light_drive, tmp_path_factory):
    """A run of base; not to be written to."""
    out = tmp_path_factory.mktemp('plot') / 'out'
    assert main(['map', str(light_drive), str(out), '--strategy', 'base']) == 0
    return out


@pytest.fixture
def plot(capsys):
    def run(*arguments):
        capsys.readouterr()
        status = main(['plot', *map(str, arguments)])
        printed = capsys.readouterr()
        return status, printed.out.strip(), printed.err

    return run


KINDS = [('graph',), ('map',), ('map', '--side'), ('trajectory',)]


@pytest.mark.parametrize('kind', KINDS, ids=' '.join)
def test_three_formats(plot, folder, tmp_path, kind):
    for suffix, head in (('.png', b'\x89PNG'), ('.svg', b'<?xml'), ('.PDF', b'%PDF')):
        path = tmp_path / f'picture{suffix}'
        assert plot(*kind, folder, '--out', path)[:2] == (0, str(path))
        content = path.read_bytes()
        assert content.startswith(head)
        assert len(content) > 10_000
    pixels = image.imread(tmp_path / 'picture.png')[:, :, :3]
    height, width = pixels.shape[:2]
    assert pixels[height // 4 : -height // 4, width // 4 : -width // 4].std() > 0.02


def test_pictures_of_the_themes_differ_in_their_ground(plot, folder, tmp_path):
    corners = {}
    for theme in ('light', 'dark'):
        path = tmp_path / f'{theme}.png'
        assert plot('map', folder, '--theme', theme, '--out', path)[0] == 0
        corners[theme] = image.imread(path)[0, 0, :3].mean()
    assert corners['light'] > 0.95 and corners['dark'] < 0.15


def test_without_a_name_it_is_in_the_folder(plot, folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / 'copy')
    for kind, name in (
        (['map', '--side'], 'map_side.png'),
        (['graph'], 'graph.png'),
        (['trajectory'], 'trajectory.png'),
    ):
        (copy / name).unlink(missing_ok=True)
        assert plot(*kind, copy)[:2] == (0, str(copy / name))
        assert (copy / name).is_file()


def test_span_may_be_given_in_seconds_and_as_stamps(plot, folder, tmp_path):
    run = FinishedRun(folder)
    start, end = run.first_stamp + 500_000_000, run.first_stamp + 1_250_000_000
    spans = [
        ('0.5', '1.25'),
        (str(start), str(end)),
        tuple(f'{stamp // 10**9}.{stamp % 10**9:09d}' for stamp in (start, end)),
    ]
    pictures = set()
    for number, (first, last) in enumerate(spans):
        path = tmp_path / f'{number}.svg'
        assert plot('graph', folder, '--from', first, '--to', last, '--out', path)[0] == 0
        pictures.add(path.read_bytes())
    assert len(pictures) == 1
    other = tmp_path / 'other.svg'
    plot('graph', folder, '--from', '0.6', '--to', '1.25', '--out', other)
    assert other.read_bytes() not in pictures


def test_truth_is_drawn_from_a_file_or_from_beside(plot, folder, light_drive, tmp_path):
    out = tmp_path / 'drive' / 'base'
    shutil.copytree(folder, out)
    plain, given, beside = (tmp_path / f'{name}.png' for name in ('plain', 'given', 'beside'))
    truth = light_drive / 'global_pose.csv'
    assert plot('trajectory', out, '--out', plain)[0] == 0
    assert plot('trajectory', out, '--truth', truth, '--out', given)[0] == 0
    from incremental_mapper.datasets.truth import read_truth

    write_tum(out.parent / 'truth.tum', read_truth(truth))
    assert plot('trajectory', out, '--out', beside)[0] == 0
    pixels = {path.stem: image.imread(path) for path in (plain, given, beside)}
    # The truth may reach further, and the picture with it.
    assert not np.array_equal(pixels['plain'], pixels['given'])
    # TUM keeps nanometres: the same picture.
    assert abs(pixels['given'] - pixels['beside']).max() < 0.05


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['graph', '--from', '2', '--to', '1'], '--from must be before --to'),
        (['graph', '--from', '60', '--to', '61'], 'no cluster from 60.000 s to 61.000 s'),
        (['graph', '--from', 'early'], "'early' is no time"),
        (['map', '--out', 'picture.jpg'], "suffix '.jpg'; pictures are .png, .svg, .pdf"),
        (['map', '--out', 'picture'], "suffix ''"),
        (['map', '--out', '/nowhere/picture.png'], 'cannot be written'),
        (['trajectory', '--truth', 'missing.tum'], 'missing.tum: is no file'),
    ],
)
def test_what_is_wrong_is_said(plot, folder, arguments, words):
    status, out, err = plot(arguments[0], folder, *arguments[1:])
    assert (status, out) == (1, '')
    assert words in err and len(err.splitlines()) == 1


@pytest.mark.parametrize('kind', ['graph', 'map', 'trajectory'])
def test_folder_that_is_no_run(plot, tmp_path, kind):
    assert 'stats.json is missing' in plot(kind, tmp_path)[2]
    assert 'no such folder' in plot(kind, tmp_path / 'nowhere')[2]


def test_map_that_was_damaged(plot, folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / 'copy')
    whole = (copy / 'map.ply').read_bytes()
    for content in (b'no map', b'', whole[:-7], whole[:100]):
        (copy / 'map.ply').write_bytes(content)
        status, _, err = plot('map', copy)
        assert status == 1 and 'map.ply: is damaged' in err
