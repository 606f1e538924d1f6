"""``report.html`` stands alone, says what the record says, and is seen in light and in dark."""

import io
import json
import os
import re
import shutil
import sys
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest

from incremental_mapper.cli.main import main
from incremental_mapper.errors import InputError
from incremental_mapper.evaluation.table import ROWS, Entry

image = pytest.importorskip('matplotlib.image', reason='matplotlib is not installed ("report")')
pytest.importorskip('jinja2', reason='jinja2 is not installed (extra "report")')

from incremental_mapper.evaluation.report.charts import trade_figure  # noqa: E402
from incremental_mapper.evaluation.report.drawings import FLAT, trade_picture  # noqa: E402
from incremental_mapper.evaluation.report.page import write_report  # noqa: E402
from incremental_mapper.evaluation.report.run_page import write_run_report  # noqa: E402

BROWSERS = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
PICTURES = 6
"""Of a drive that was mapped with base and the method, with truth."""


@pytest.fixture(scope='module')
def evaluation(light_drive, tmp_path_factory):
    """An evaluation of one drive and one folder that is none; not to be written to."""
    out = tmp_path_factory.mktemp('report') / 'out'
    broken = tmp_path_factory.mktemp('inputs') / 'broken'
    (broken / 'sensor_data').mkdir(parents=True)
    settings = broken.parent / 'settings.yaml'
    settings.write_text('mom:\n  max_points: 100\n')
    words = ('--strategies', 'base,mom', '--config', settings, '--out', out)
    main(['evaluate', str(light_drive), str(broken), *map(str, words)])
    write_report(out)
    return out


@pytest.fixture
def changed(evaluation, tmp_path):
    """Write the page of a copy whose record a function has changed; returns its text."""

    def write(change):
        copy = shutil.copytree(evaluation, tmp_path / 'copy')
        path = copy / 'evaluation.json'
        record = json.loads(path.read_text(encoding='utf-8'))
        change(record)
        path.write_text(json.dumps(record), encoding='utf-8')
        return write_report(copy).read_text(encoding='utf-8')

    return write


class Tags(HTMLParser):
    """All start tags with their attributes, and the text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.words, self.style = [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.style = tag == 'style'
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        self.style = False

    def handle_data(self, data):
        if not self.style:
            self.words.append(data)

    @property
    def text(self):
        return ' '.join(' '.join(self.words).split())

    def named(self, name):
        return [attrs for tag, attrs in self.tags if tag == name]


def page_of(folder):
    return (folder / 'report.html').read_text(encoding='utf-8')


def test_page_needs_nothing_else(evaluation):
    text = page_of(evaluation)
    page = Tags(text)
    assert page.named('script') == [] and page.named('link') == []
    links = [
        attrs[name]
        for _, attrs in page.tags
        for name in ('src', 'href', 'xlink:href')
        if name in attrs
    ]
    assert links and all(link.startswith(('#', 'data:image/')) for link in links)
    assert re.findall(r'url\((?!#|&)[^)]*\)|@import', text) == []
    assert len(text) < 800_000


def test_names_inside_are_unique_and_found(evaluation):
    page = Tags(page_of(evaluation))
    names = Counter(attrs['id'] for _, attrs in page.tags if 'id' in attrs)
    assert [name for name, count in names.items() if count > 1] == []
    wanted = [
        attrs[name][1:]
        for _, attrs in page.tags
        for name in ('href', 'xlink:href')
        if attrs.get(name, '').startswith('#')
    ]
    wanted += re.findall(r'url\(#([^)]*)\)', page_of(evaluation))
    assert set(wanted) <= set(names)


def test_pictures_are_described_and_take_the_colours_of_the_page(evaluation):
    text = page_of(evaluation)
    pictures = [attrs for attrs in Tags(text).named('svg')]
    assert len(pictures) == PICTURES
    assert all(attrs['role'] == 'img' and len(attrs['aria-label']) > 20 for attrs in pictures)
    assert len({attrs['aria-label'] for attrs in pictures}) == PICTURES
    assert '#01' not in ''.join(re.findall(r'(?:fill|stroke): ?#\w+', text))
    declared = set(re.findall(r'--([\w-]+):', text))
    assert set(re.findall(r'var\(--([\w-]+)\)', text)) <= declared
    for role in ('ink', 'ground', 'blue', 'vermillion', 'even', 'odd'):
        assert text.count(f'var(--{role})') > 3


def test_tables_have_headers(evaluation):
    page = Tags(page_of(evaluation))
    assert len(page.named('caption')) == len(page.named('table')) >= 3
    assert all('scope' in attrs for attrs in page.named('th'))


def test_numbers_are_those_of_the_record(evaluation):
    record = json.loads((evaluation / 'evaluation.json').read_text(encoding='utf-8'))
    text = Tags(page_of(evaluation)).text
    rows = {row.name: row for row in ROWS}
    done = [job for job in record['jobs'] if job['status'] == 'done']
    assert len(done) == 2
    for job in done:
        for name, value in job['metrics'].items():
            if name in rows:
                assert rows[name].text(value) in text, name
    saving = done[1]['metrics']['compression_vertices_percent']
    assert (
        f'mom keeps {saving:.1f} % fewer variables than base; its drift over a second is ' in text
    )
    for word in (*record['versions'].values(), record['command'], record['created']):
        assert ' '.join(word.split()) in text


def test_failed_runs_tell_their_reason(evaluation):
    record = json.loads((evaluation / 'evaluation.json').read_text(encoding='utf-8'))
    failed = [job for job in record['jobs'] if job['status'] == 'failed']
    assert {job['sequence'] for job in failed} == {'broken'} and len(failed) == 2
    text = Tags(page_of(evaluation)).text
    # Once in the summary and once with the drive, for both strategies together.
    assert text.count(' '.join(failed[0]['error'].split())) == 2
    assert '2 runs failed' in text


def without(strategy):
    def change(record):
        record['strategies'].remove(strategy)
        record['jobs'] = [job for job in record['jobs'] if job['strategy'] != strategy]

    return change


def test_base_alone(changed):
    text = changed(without('mom'))
    assert 'graph of base is connected' in text or 'graphs of base' in text
    assert 'fewer variables than base' not in text
    assert text.count('<svg') == PICTURES - 1


def test_method_alone(changed):
    text = changed(without('base'))
    assert 'mom keeps' in text
    assert 'clusters saved' in text, 'without a base run clusters are counted'
    assert text.count('<svg') == PICTURES - 1


def test_without_truth(changed):
    def change(record):
        for sequence in record['sequences']:
            sequence['truth'] = None
        for job in record['jobs']:
            for name in job['metrics']:
                if name.startswith(('rpe', 'ate')):
                    job['metrics'][name] = None

    text = changed(change)
    assert 'no truth to measure errors against' in text
    assert 'without truth to compare with' in text
    assert text.count('<svg') == PICTURES


def test_nothing_finished(changed):
    def change(record):
        record['status'] = 'running'
        for job in record['jobs']:
            job.update(status='waiting', metrics={}, by_motion={}, error=None)

    text = changed(change)
    assert 'No run has finished' in text
    assert 'had not finished when this page was made' in text
    assert '<svg' not in text


def test_one_drive_has_no_means(changed):
    def change(record):
        record['sequences'] = [s for s in record['sequences'] if s['name'] != 'broken']
        record['jobs'] = [job for job in record['jobs'] if job['sequence'] != 'broken']
        record['remarks'] = []

    text = Tags(changed(change)).text
    assert '1 drive (KAIST folder)' in text
    assert 'failed' not in text and 'Means' not in text


def test_pieces_by_motion_have_a_table_of_their_own(changed):
    def change(record):
        for job in record['jobs']:
            if job['metrics']:
                pieces = ('acceleration', 'deceleration')
                job['by_motion'] = {motion: dict(job['metrics']) for motion in pieces}

    page = Tags(changed(change))
    assert 'By drive' in page.text and 'By motion' in page.text
    assert 'Acceleration' in page.text and 'Deceleration' in page.text
    assert len(page.named('table')) == 5


def test_names_are_text_not_markup(changed):
    def change(record):
        name = '<script>alert("&")</script>'
        for item in record['sequences']:
            item['name'] = name if item['name'] != 'broken' else 'broken'
        for job in record['jobs']:
            job['sequence'] = name if job['sequence'] != 'broken' else 'broken'

    page = Tags(changed(change))
    assert page.named('script') == []
    assert '<script>alert("&")</script>' in page.text


def test_folder_that_is_no_evaluation(tmp_path):
    with pytest.raises(InputError, match='is no record'):
        write_report(tmp_path)
    for text in ('no json', '[]', '{"sequences": []}'):
        (tmp_path / 'evaluation.json').write_text(text)
        with pytest.raises(InputError, match='is no record'):
            write_report(tmp_path)


@pytest.fixture(scope='module')
def browser():
    """A headless Chromium."""
    sync = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    surroundings = dict(os.environ)
    own = Path(sys.prefix) / 'browser'
    if path is None and (own / 'chromium').is_file():
        path = str(own / 'chromium')
        surroundings |= {
            'LD_LIBRARY_PATH': str(own / 'lib'),
            'FONTCONFIG_FILE': str(own / 'fonts.conf'),
        }
    if path is None:
        pytest.skip('no Chromium: apt-get install chromium, or .ci/browser .venv/browser')
    with sync.sync_playwright() as player:
        running = player.chromium.launch(
            executable_path=path, args=['--no-sandbox'], env=surroundings
        )
        yield running
        running.close()


@pytest.fixture(params=['light', 'dark'])
def opened(browser, evaluation, request):
    """The page from its file, without a network, in one theme: theme, page, troubles."""
    context = browser.new_context(
        color_scheme=request.param, offline=True, viewport={'width': 1340, 'height': 900}
    )
    page, troubles = context.new_page(), []
    page.on('console', lambda message: troubles.append(message.text))
    page.on('pageerror', lambda error: troubles.append(str(error)))
    page.on('requestfailed', lambda failed: troubles.append(failed.url[:100]))
    page.goto((evaluation / 'report.html').as_uri())
    yield request.param, page, troubles
    context.close()


def pixels(shot):
    return image.imread(io.BytesIO(shot))[:, :, :3]


def test_ground_follows_the_theme(opened):
    theme, page, _ = opened
    corner = pixels(page.screenshot())[5, 5]
    assert corner.mean() > 0.95 if theme == 'light' else corner.mean() < 0.15


def test_no_picture_is_blank(opened):
    theme, page, troubles = opened
    pictures = page.locator('figure svg')
    assert pictures.count() == PICTURES
    for index in range(PICTURES):
        picture = pictures.nth(index)
        shot = pixels(picture.screenshot())
        assert min(shot.shape[:2]) > 250
        drawn = abs(shot - shot[2, 2]).max(axis=2) > 0.25
        name = picture.get_attribute('aria-label')
        assert drawn.mean() > 0.015, f'{name} in {theme}'
        height, width = drawn.shape
        middle = drawn[height // 4 : -height // 4, width // 4 : -width // 4]
        assert middle.mean() > 0.005, f'{name} in {theme}'
    assert troubles == []


def test_rasters_inside_the_pictures_load(opened):
    _, page, _ = opened
    sizes = page.evaluate(
        """() => Promise.all([...document.querySelectorAll('svg image')].map(async element => {
            const copy = new Image();
            copy.src = element.href.baseVal;
            await copy.decode();
            return copy.naturalWidth;
        }))"""
    )
    # The points of two maps and the colours beside them.
    assert len(sizes) >= 4 and min(sizes) > 0 and max(sizes) > 400


def test_text_stands_out(opened):
    """Contrast of the common colours upon the page, by the measure of WCAG 2."""
    _, page, _ = opened
    colours = page.evaluate(
        """() => Object.fromEntries(['ground', 'ink', 'muted', 'blue'].map(role =>
            [role, getComputedStyle(document.documentElement).getPropertyValue('--' + role)]))"""
    )

    def luminance(colour):
        channels = [int(colour.strip()[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    ground = luminance(colours['ground'])
    for role in ('ink', 'muted', 'blue'):
        darker, lighter = sorted((luminance(colours[role]), ground))
        assert (lighter + 0.05) / (darker + 0.05) >= 4.5, role


@pytest.mark.parametrize('width', [400, 1340, 2200])
def test_page_fits_the_window(browser, evaluation, width):
    page = browser.new_page(viewport={'width': width, 'height': 900})
    page.goto((evaluation / 'report.html').as_uri())
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    page.close()


def entries_of(numbers):
    """Entries of two drives by label: variables saved (%) and RPE per second (m)."""
    names = ('compression_vertices_percent', 'rpe_per_second_translation_rmse_m')
    return [
        Entry(drive, None, label, dict(zip(names, pair, strict=True)))
        for drive in ('monday', 'tuesday')
        for label, pair in numbers.items()
    ]


def test_a_sweep_of_confidences_is_drawn_as_a_line_from_point_to_point():
    numbers = {
        'base': (0.0, 0.026),
        'mom@0.95': (59.0, 0.024),
        'mom@0': (31.0, 0.026),
        'fewest': (60.0, 0.030),
    }
    picture = trade_picture(entries_of(numbers), tuple(numbers))
    assert all(f'>{label}<' in picture.svg or label in picture.svg for label in numbers)
    assert 'means over the drives' in picture.caption
    figure = trade_figure({name: (100 * e, s) for name, (s, e) in numbers.items()}, FLAT)
    (axes,) = figure.axes
    (line,) = [line for line in axes.lines if len(line.get_xdata()) > 1]
    assert list(line.get_ydata()) == [31.0, 59.0], 'in the order of the confidences'


def test_base_far_away_does_not_squeeze_what_the_strategies_differ_in():
    points = {
        'base': (0.80, 0.0),
        'mom@0': (0.49, 63.3),
        'mom@0.5': (0.48, 63.5),
        'mom@0.95': (0.49, 72.8),
        'mom@0.99': (0.50, 73.3),
    }
    figure = trade_figure(points, FLAT)
    (axes,) = figure.axes
    ends = [axes.transLimits.transform(points[label]) for label in ('mom@0.5', 'mom@0.99')]
    assert min(abs(ends[1] - ends[0])) > 0.5
    assert 'base: 0.8 cm, 0 %' in [text.get_text() for text in axes.texts]
    near = dict(points) | {'base': (0.52, 60.0)}
    (axes,) = trade_figure(near, FLAT).axes
    assert 'base' in [text.get_text() for text in axes.texts]


def test_two_strategies_or_no_truth_make_no_chart_of_the_trade():
    assert trade_picture(entries_of({'base': (0, 0.1), 'mom': (30, 0.1)}), ('base', 'mom')) is None
    blind = {'base': (0, None), 'mom': (30, None), 'fewest': (50, None)}
    assert trade_picture(entries_of(blind), tuple(blind)) is None


def test_table_is_read_at_the_width_of_a_telephone(browser, evaluation):
    """Names scrolled out of sight with the numbers, and drives took the room of both."""
    page = browser.new_page(viewport={'width': 400, 'height': 900})
    page.goto((evaluation / 'report.html').as_uri())
    table = page.locator('.scroll').first
    name = table.locator('tbody th[scope="row"]').first
    before = name.bounding_box()
    assert table.evaluate('e => e.scrollWidth > e.clientWidth')
    table.evaluate('e => { e.scrollLeft = 300; }')
    assert name.bounding_box()['x'] == pytest.approx(before['x'], abs=12)
    assert table.locator('tr.narrow').first.is_visible()
    assert not table.locator('thead .drive-name').is_visible()
    page.close()


def test_no_column_is_cut_off_at_1200_pixels(browser, evaluation):
    page = browser.new_page(viewport={'width': 1200, 'height': 900})
    page.goto((evaluation / 'report.html').as_uri())
    tables = page.evaluate(
        "[...document.querySelectorAll('.scroll')].map(e => e.scrollWidth - e.clientWidth)"
    )
    assert tables and max(tables) <= 0
    page.close()


def test_page_of_a_run_stands_alone(evaluation, tmp_path):
    folder = shutil.copytree(evaluation / 'light' / 'mom', tmp_path / 'copy')
    write_run_report(folder)
    text = page_of(folder)
    page, stats = Tags(text), json.loads((folder / 'stats.json').read_text(encoding='utf-8'))
    assert page.named('script') == [] and page.named('link') == []
    assert re.findall(r'url\((?!#|&)[^)]*\)|@import', text) == []
    links = [v for _, attrs in page.tags for k, v in attrs.items() if k in ('src', 'xlink:href')]
    assert links and all(link.startswith(('#', 'data:image/')) for link in links)
    names = Counter(attrs['id'] for _, attrs in page.tags if 'id' in attrs)
    assert max(names.values()) == 1
    assert len(page.named('svg')) == 5
    for number in (stats['vertices'], stats['base_vertices'], f'{stats["ate_rmse_m"]:.4f} m'):
        assert str(number) in page.text
    assert 'is not to be trusted' not in page.text


def test_pages_tell_a_score_in_words(evaluation):
    """``mom_2`` is a name of windows.csv, which nobody knows who sees his first page."""
    text = (evaluation / 'report.html').read_text(encoding='utf-8')
    (title,) = re.findall(r'score of the winners of mom: ([^<]+)<', text)
    assert title.endswith('m²')


def test_page_of_a_run_leads_with_what_is_wrong(evaluation, tmp_path):
    copy = shutil.copytree(evaluation / 'light' / 'mom', tmp_path / 'copy')
    stats = json.loads((copy / 'stats.json').read_text(encoding='utf-8'))
    finding = {
        'rule': 'x',
        'severity': 'error',
        'sensor': 'gnss',
        'text': 'is <off>',
        'remedy': 'y',
    }
    (copy / 'stats.json').write_text(json.dumps(stats | {'warnings': [finding]}))
    write_run_report(copy)
    text = Tags(page_of(copy)).text
    assert 'This map is not to be trusted' in text and 'error, gnss: is <off>; y' in text
    assert '<off>' not in page_of(copy).replace('&lt;off&gt;', '')
