"""The process that searches for closed loops: what it finds comes back, and nothing else does."""

import os
import pickle
import signal
import time

import gtsam
import numpy as np

from incremental_mapper.mapping.live_closing import Correction, Search
from incremental_mapper.mapping.loop_closing import NOT_LOOKED, Looked
from incremental_mapper.ros.search_process import ENDED, FAULT, SearchProcess
from incremental_mapper.smoothing.correction import Evidence
from incremental_mapper.variables import pose_key


def answer(process, seconds=20.0):
    end = time.monotonic() + seconds
    while (arrived := process.arrived()) is None:
        assert time.monotonic() < end, 'no answer'
        time.sleep(0.01)
    return arrived


def values(*clusters):
    made = gtsam.Values()
    for cluster in clusters:
        made.insert(pose_key(cluster), gtsam.Pose3(gtsam.Rot3(), np.full(3, float(cluster))))
    return made


def test_what_is_found_comes_back_with_its_values():
    process, here = SearchProcess(), os.getpid()
    evidence = Evidence((pose_key(4),), values(4), np.eye(6), np.ones(6), gtsam.Pose3())
    parts = tuple(pickle.dumps(values(*part)) for part in ((0, 1), (2,)))

    def search():
        correction = Correction(evidence, parts, values(3, 4), 5, 1.5)
        return Search(Looked((), {(0, 4): 'alone'}), {'candidates': os.getpid()}, (), correction)

    assert process.start(search)
    arrived = answer(process)
    assert arrived.search.told['candidates'] != here  # it was another process
    assert arrived.older.equals(values(0, 1, 2), 0.0)
    assert arrived.search.correction.evidence.values.equals(values(4), 0.0)
    assert process.arrived() is None and process.pid is None


def test_a_process_that_dies_is_told_of():
    process = SearchProcess()
    assert process.start(lambda: time.sleep(60.0))
    os.kill(process.pid, signal.SIGKILL)
    arrived = answer(process)
    assert arrived.search is None and arrived.trouble == ENDED
    # The next one may be well.
    assert process.start(lambda: Search(NOT_LOOKED, {'candidates': 1}))
    assert answer(process).search.told == {'candidates': 1}


def test_a_search_that_raises_is_told_of_with_its_traceback():
    process = SearchProcess()
    assert process.start(lambda: 1 / 0)
    arrived = answer(process)
    assert arrived.search is None
    assert arrived.trouble.startswith(FAULT) and 'ZeroDivisionError' in arrived.trouble


def test_it_ends_with_its_map():
    process = SearchProcess()
    assert process.start(lambda: time.sleep(60.0))
    child = process.pid
    process.close()
    end = time.monotonic() + 20.0
    while process.pid is not None:
        assert time.monotonic() < end
        time.sleep(0.01)
    with np.testing.assert_raises(ProcessLookupError):
        os.kill(child, 0)
    assert process.arrived() is None
    process.close()  # nothing is left to be ended
