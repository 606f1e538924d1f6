"""Pictures and page of a run, made beside: the same ones, whatever becomes of the process."""

import os
import sys

import pytest

pytest.importorskip('matplotlib')
pytest.importorskip('jinja2')

from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.evaluation.report.report_process import ReportProcess

PICTURES = ('trajectory.png', 'map.png', 'graph.png')


@pytest.fixture(scope='module')
def run(drive, tmp_path_factory):
    from incremental_mapper import map_drive

    out = tmp_path_factory.mktemp('page') / 'out'
    return out, map_drive(drive, out, {'selection': {'strategy': 'min_time_shift'}})


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(os, 'cpu_count', lambda: 2)


def made(run, prepare, times=1):
    """Pictures and page, in bytes, and whether there are pictures."""
    folder, done = run
    for name in (*PICTURES, 'report.html'):
        (folder / name).unlink(missing_ok=True)
    with ReportProcess(folder, None) as report:
        prepare(report)
        for _ in range(times):
            report.finish(done.result, done.map)
        report.written()
        drawn = report.end()
    return drawn, [(folder / name).read_bytes() for name in (*PICTURES, 'report.html')]


def test_all_is_the_same_from_another_process_from_this_and_where_the_other_dies(run):
    def dies(report):
        report.prepare()
        report._process.kill()
        report._process.wait()

    ways = [made(run, how) for how in (ReportProcess.prepare, lambda _: None, dies)]
    assert ways[0][0] and b'<svg' in ways[0][1][-1] and ways[0][1][0].startswith(b'\x89PNG')
    assert ways == [ways[0]] * 3
    assert made(run, ReportProcess.prepare, times=2) == ways[0]  # it was mapped again


def test_what_is_raised_beside_is_raised_here(run, tmp_path):
    with ReportProcess(tmp_path, None) as report:
        report.prepare()
        report.written()
        with pytest.raises(InputError, match=str(tmp_path)):
            report.end()
    with ReportProcess(tmp_path / 'nowhere', None) as report:
        report.prepare()
        report.finish(run[1].result, run[1].map)
        report.written()
        with pytest.raises(OutputError, match='nowhere'):
            report.end()


def test_without_its_library_there_are_no_pictures_and_that_is_told(run, monkeypatch):
    folder, done = run
    (folder / 'map.png').unlink(missing_ok=True)
    monkeypatch.setitem(sys.modules, 'matplotlib', None)
    with ReportProcess(folder, None) as report:
        report.prepare()
        assert report._process is None
        report.finish(done.result, done.map)
        report.written()
        assert not report.end()
    assert not (folder / 'map.png').exists()


def test_nothing_goes_on_once_nobody_waits_for_it(tmp_path):
    with ReportProcess(tmp_path, None) as report:
        report.prepare()
        process = report._process
    assert process.poll() is not None
