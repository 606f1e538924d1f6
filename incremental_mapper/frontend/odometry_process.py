"""Scans prepared beside the mapper, each LiDAR in a process of its own.

Scan matching holds Python's lock, so threads would not run side by side; the LiDARs' chains know
nothing of each other, so processes do.
"""

import pickle
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, BinaryIO, Protocol

import numpy as np

from incremental_mapper.config import Config
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend import inertial_motion
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES, ImuSeries
from incremental_mapper.frontend.prepared_scan import PreparedScan, ScanPreparer
from incremental_mapper.frontend.preprocessing import Sweep, warm_up
from incremental_mapper.frontend.scan_servers import hold, let_go, scan_server
from incremental_mapper.helper_process import streams
from incremental_mapper.measurements import NANOSECONDS, LidarScan, make_scan

ENDED = (EOFError, OSError, pickle.UnpicklingError)
"""What is raised where the other end of a stream is gone, before or within a message."""


class ScanStation(Protocol):
    """Prepares the scans of one LiDAR in the order in which they are submitted."""

    def submit(self, scan: LidarScan, imu: ImuSeries = EMPTY_SERIES) -> 'Future[PreparedScan]':
        """Hand over the next scan; its result raises MeasurementError where it cannot be used.

        Args:
            scan: As the message has it.
            imu: The IMU's samples since the scan before, up to the end of the sweep.
        """

    def close(self) -> None:
        """Let go of what the station holds; nothing may be submitted afterwards."""


class LocalStation:
    """Prepares scans at once, in this process."""

    def __init__(self, name: str, config: Config, notes: Counter[str]) -> None:
        self._preparer = ScanPreparer(name, config, notes)

    def submit(self, scan: LidarScan, imu: ImuSeries = EMPTY_SERIES) -> 'Future[PreparedScan]':
        """See ScanStation."""
        future: Future[PreparedScan] = Future()
        try:
            future.set_result(self._preparer.prepare(scan, imu))
        except MeasurementError as error:
            future.set_exception(error)
        return future

    def close(self) -> None:
        """See ScanStation."""


class ProcessStation:
    """Prepares scans in a process of its own; should that die, the next scans stay here."""

    def __init__(self, name: str, config: Config, notes: Counter[str]) -> None:
        self._name, self._config, self._notes = name, config, notes
        self._here: ScanPreparer | None = None
        self._closed = False
        hold()
        self._process = scan_server()
        # One thread sends and another takes answers, so that the next scan is there when the
        # process is done with one.
        self._sender = ThreadPoolExecutor(1, thread_name_prefix=f'to_{name}')
        self._receiver = ThreadPoolExecutor(1, thread_name_prefix=f'from_{name}')
        self._sender.submit(self._send, (name, config))

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def submit(self, scan: LidarScan, imu: ImuSeries = EMPTY_SERIES) -> 'Future[PreparedScan]':
        """See ScanStation."""
        self._sender.submit(self._send, (scan, imu))
        return self._receiver.submit(self._receive, scan, imu)

    def close(self) -> None:
        """See ScanStation."""
        for thread in (self._sender, self._receiver):
            thread.shutdown(wait=False, cancel_futures=True)
        self._process.kill()
        self._process.wait()
        if not self._closed:
            self._closed = True
            let_go()

    def _send(self, item: Any) -> None:
        assert self._process.stdin is not None
        if self._here is not None:
            return
        try:
            pickle.dump(item, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
        except (OSError, ValueError):
            pass  # it has ended or was closed: no answer will come, which is noticed there

    def _receive(self, scan: LidarScan, imu: ImuSeries) -> PreparedScan:
        assert self._process.stdout is not None
        if self._here is None:
            try:
                result, notes = pickle.load(self._process.stdout)
            except ENDED:
                self._notes[f'{self._name}: its process ended, scans are prepared here'] += 1
                self._here = ScanPreparer(self._name, self._config, self._notes)
            else:
                self._notes.update(notes)
                if isinstance(result, PreparedScan):
                    return result
                raise MeasurementError(*result)
        return self._here.prepare(scan, imu)


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Read name and settings, then scans with samples; answer each with a result and new notes.

    It ends where the streams do, wherever in a message that is: whoever asks may have been killed.
    """
    with suppress(*ENDED):
        _answer(requests, answers)


def _answer(requests: BinaryIO, answers: BinaryIO) -> None:
    name, config = pickle.load(requests)
    notes: Counter[str] = Counter()
    preparer = ScanPreparer(name, config, notes)

    def read() -> tuple[Sweep, ImuSeries]:
        scan, imu = pickle.load(requests)
        return preparer.thinned(scan), imu

    # The next scan is read and thinned while one is matched: the kernels hold no lock.
    with ThreadPoolExecutor(1) as ahead:
        coming = ahead.submit(read)
        while True:
            sweep, imu = coming.result()
            coming = ahead.submit(read)
            try:
                result: object = preparer.match(sweep, imu)
            except MeasurementError as error:
                result = (error.reason, str(error))
            pickle.dump((result, dict(notes)), answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()
            notes.clear()


def get_ready() -> None:
    """Bring into memory what the first scans would wait for."""
    inertial_motion.warm_up()
    preparer = ScanPreparer('', Config(), Counter())
    places = np.arange(-10.0, 10.0, 0.5)
    ground = np.stack([*np.meshgrid(places, places), np.zeros((40, 40))], axis=-1).reshape(-1, 3)
    for tenths in range(2):
        preparer.prepare(make_scan(tenths * NANOSECONDS // 10, '', ground))


def main() -> None:
    """Serve on the standard streams."""
    requests, answers = streams()
    warm_up()
    serve(requests, answers)


if __name__ == '__main__':
    main()
