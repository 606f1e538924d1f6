"""The command as a process: exit status, what is on stderr, and Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from incremental_mapper.cli import exit_status
from incremental_mapper.cli.main import main
from incremental_mapper.datasets.open import open_source
from incremental_mapper.results.offline_run import Stop, map_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.trajectory import read_tum

COMMAND = [sys.executable, '-m', 'incremental_mapper.cli.main']
FILES = ('trajectory.tum', 'map.ply', 'graph.g2o', 'graph.json', 'windows.csv', 'stats.json')


def run(*words):
    return subprocess.run([*COMMAND, *map(str, words)], capture_output=True, text=True, timeout=60)


def start(*words):
    """Start the command; returns when it has begun to read the bag (its notes are printed)."""
    process = subprocess.Popen(
        [*COMMAND, *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    line = process.stderr.readline()
    while line and 'LiDAR' not in line:
        line = process.stderr.readline()
    return process


def test_a_name_that_is_no_text_is_refused_before_anything_is_mapped(tmp_path, capsys):
    """A folder named in Latin 1: a file of the run could not be written after all was mapped."""
    named = os.fsdecode(os.fsencode(tmp_path) + b'/M\xe4rz')
    out = str(tmp_path / 'out')
    for words in (['map', named, out], ['map', out, named], ['check', out, '--write', named]):
        assert main(words) == exit_status.FAILURE
        (line,) = capsys.readouterr().err.splitlines()
        assert 'M\\udce4rz' in line and 'rename' in line
    assert not list(tmp_path.iterdir())


def test_refused_input_is_one_line_and_status_1(tmp_path):
    done = run('map', tmp_path / 'none', tmp_path / 'out')
    assert done.returncode == 1
    assert done.stdout == ''
    assert done.stderr.count('\n') == 1
    assert done.stderr.startswith('incremental_mapper: ')
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(
    'words', [(), ('map',), ('map', 'a'), ('map', 'a', 'b', '--strategy', 'best'), ('dance',)]
)
def test_wrong_usage_is_status_2(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert 'usage: incremental_mapper' in capsys.readouterr().err


def test_an_option_that_a_command_does_not_have_shows_those_that_it_has(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(['map', 'a', 'b', '--set', 'window.duration=0.3'])
    assert stopped.value.code == 2
    told = capsys.readouterr().err
    assert '--config YAML' in told and 'arguments: --set window.duration=0.3' in told


@pytest.mark.parametrize('words', [('--help',), ('map', '--help')])
def test_help_is_status_0(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 0
    assert 'map' in capsys.readouterr().out


def test_ctrl_c_writes_what_has_been_mapped(bag, tmp_path):
    # When the first windows are there, and when all is read, depends on what else runs.
    soon, late, seconds = 0.0, 0.0, 0.4
    while True:
        out = tmp_path / f'out_{seconds}'
        process = start('map', bag, out)
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
        assert 'Traceback' not in errors
        if printed and process.returncode == 130:
            break
        assert process.returncode in (0, 130), errors
        if process.returncode == 0:
            late = seconds
        else:
            soon = seconds
        seconds = (soon + late) / 2 if late else 1.5 * seconds
    assert 'interrupted' in printed
    assert all((out / name).is_file() for name in FILES)
    assert not list(out.glob('.*'))
    stats = json.loads((out / 'stats.json').read_text())
    graph = json.loads((out / 'graph.json').read_text())
    assert stats['interrupted'] is True
    assert sum(stats['received'].values()) < sum(stats['input']['counts'].values())
    assert len(read_tum(out / 'trajectory.tum')) == len(graph['clusters']) == stats['clusters'] > 0


def test_further_ctrl_c_ends_at_once(bag, tmp_path):
    """However often it is pressed, and while the program is ending too."""
    process = start('map', bag, tmp_path / 'out')
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert 'Traceback' not in errors
    assert errors.splitlines()[-1] == 'incremental_mapper: interrupted'
    assert not (tmp_path / 'out' / 'stats.json').exists()


def test_second_ctrl_c_interrupts():
    before = signal.getsignal(signal.SIGINT)
    with Stop().listening() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.wanted
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_before_the_first_scan_is_no_failure(light_drive):
    """Nothing was read yet: that the input holds nothing usable would be a false reproach."""
    source = open_source(light_drive)
    stop = Stop()
    stop.wanted = True
    with pytest.raises(KeyboardInterrupt):
        map_source(source, effective_config(source, {}, 'settings'), stop=stop)


def test_a_reader_that_goes_away_gets_no_traceback():
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [*COMMAND, 'map', '--help'],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        env=os.environ | {'PYTHONUNBUFFERED': ''},
    )
    os.close(writing)
    assert done.stderr == ''
    assert done.returncode == exit_status.PIPE_CLOSED
