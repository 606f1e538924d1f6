"""The page of a run, written beside: the same one, whatever becomes of the process."""

import os

import pytest

pytest.importorskip('matplotlib')
pytest.importorskip('jinja2')

from incremental_mapper.errors import InputError
from incremental_mapper.evaluation.report.report_process import ReportProcess


@pytest.fixture(scope='module')
def folder(drive, tmp_path_factory):
    from incremental_mapper import map_drive

    out = tmp_path_factory.mktemp('page') / 'out'
    map_drive(drive, out, {'selection': {'strategy': 'min_time_shift'}})
    return out


def page_of(folder, prepare):
    (folder / 'report.html').unlink(missing_ok=True)
    with ReportProcess() as report:
        prepare(report)
        report.begin(folder, None)
        report.end()
    return (folder / 'report.html').read_text(encoding='utf-8')


def test_page_is_the_same_from_another_process_from_this_and_where_the_other_dies(
    folder, monkeypatch
):
    monkeypatch.setattr(os, 'cpu_count', lambda: 2)

    def dies(report):
        report.prepare()
        report._process.kill()
        report._process.wait()

    pages = [page_of(folder, how) for how in (ReportProcess.prepare, lambda _: None, dies)]
    assert '<svg' in pages[0]
    assert pages == [pages[0]] * 3


def test_what_is_raised_beside_is_raised_here(tmp_path, monkeypatch):
    monkeypatch.setattr(os, 'cpu_count', lambda: 2)
    with ReportProcess() as report:
        report.prepare()
        report.begin(tmp_path, None)
        with pytest.raises(InputError, match=str(tmp_path)):
            report.end()


def test_nothing_goes_on_once_nobody_waits_for_it(tmp_path, monkeypatch):
    monkeypatch.setattr(os, 'cpu_count', lambda: 2)
    with ReportProcess() as report:
        report.prepare()
        process = report._process
    assert process.poll() is not None
