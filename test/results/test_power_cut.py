"""A program that is killed in the middle of a drive: its journal holds the map so far."""

import subprocess
import sys

from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.journal.recovered_folder import recover_journal
from incremental_mapper.results.manifest import require_whole

# Tells of each window once it is mapped, before it is in the journal.
CHILD = """
import sys
from collections import Counter
from pathlib import Path
from incremental_mapper.datasets.open import open_source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.journal.journal_writer import Journal
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.results.run_statistics import InputFacts

drive, folder = map(Path, sys.argv[1:])
tree = {'selection': {'strategy': 'min_time_shift'}}
source = open_source(drive, tree)
config = effective_config(source, tree, 'test')
journal = Journal(folder, config, InputFacts('here', 'test', {}))
mapper = Mapper(config, store=journal)
for item in source.measurements():
    for window in mapper.push(item):
        sys.stdout.write('.')
        sys.stdout.flush()
        journal.window(mapper, window, Counter())
"""


def test_killed_programs_lose_one_window_at_most(light_drive, tmp_path):
    running = {}
    for moment in (4, 15):
        words = [sys.executable, '-c', CHILD, str(light_drive), str(tmp_path / str(moment))]
        running[moment] = subprocess.Popen(words, stdout=subprocess.PIPE)
    for moment, child in running.items():
        told = len(child.stdout.read(moment))
        child.kill()
        told += len(child.communicate()[0])
        (path,) = (tmp_path / str(moment)).glob('*.journal')
        done = recover_journal(path, tmp_path / f'map_{moment}', remove=True, pictures=False)
        require_whole(done.folder)
        run = FinishedRun(done.folder)
        assert moment <= told <= len(run.windows) + 1
        assert run.stats['components'] == 1 and run.stats['georeferenced'] == (moment > 4)
        assert len(run.trajectory) == len(run.graph['clusters']) and len(run.points) > 1000
        assert not path.exists()
