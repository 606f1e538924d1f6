"""What /diagnostics tells: every input, the worker, the map, and what was found wrong."""

import time
from collections.abc import Mapping
from math import inf
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import Header

from incremental_mapper.mapping.load_shedding import NO_SHEDDING
from incremental_mapper.mapping.statistics import STAGES
from incremental_mapper.ros.drop_log import DropLog
from incremental_mapper.ros.inbox import MERGE_FROM
from incremental_mapper.ros.known_findings import KnownFindings
from incremental_mapper.ros.rclpy_types import MESSAGES
from incremental_mapper.ros.subscriptions import GNSS, Inputs
from incremental_mapper.ros.updates import WindowUpdate
from incremental_mapper.ros.vitals import (
    NO_WINDOW,
    Events,
    Flow,
    InputCounts,
    InputVitals,
    Level,
    Verdict,
)
from incremental_mapper.ros.worker import Worker

MAPPER_KEYS = (
    'windows',
    'clusters',
    'vertices',
    'factors',
    'components',
    'bridges',
    'weak_matches',
    'doubted_imu_s',
    'georeferenced',
    'failed_windows',
)
MB = 1e6


LEVELS = {
    Level.OK: DiagnosticStatus.OK,
    Level.WARN: DiagnosticStatus.WARN,
    Level.ERROR: DiagnosticStatus.ERROR,
}


class Health:
    """Makes the diagnostics; used in the executor's thread only.

    Levels tell of the time since the last message, values of all that was since the beginning.
    What is left out is logged.
    """

    def __init__(
        self,
        name: str,
        inputs: Inputs,
        worker: Worker,
        findings: KnownFindings,
        logger: RcutilsLogger,
    ) -> None:
        self._name = name
        self._inputs = inputs
        self._worker = worker
        self._findings = findings
        self._logger = logger
        self._last: WindowUpdate | None = None
        self._windows = 0
        self._vitals = {sensor: InputVitals(needed=sensor != GNSS) for sensor in inputs.topics}
        settings = worker.config.window
        # A window may wait for a silent sensor, and be carried, before it is told of.
        usual = settings.duration + settings.lateness + settings.max_carry
        self._flow = Flow(max(NO_WINDOW, 3.0 * usual))
        # A window may wait for a silent sensor; from half of what may wait on windows are merged.
        most = worker.config.queue.max_delay
        self._late = settings.duration + max(settings.lateness, MERGE_FROM * most) if most else inf
        self._events = Events()
        self._drop_log = DropLog()

    def window(self, update: WindowUpdate) -> None:
        """Remember the newest window."""
        self._last = update
        self._windows += 1
        if not update.on_order:
            self._inputs.lag.told(update.result.start, update.result.end, time.time())

    def restart(self) -> None:
        """Forget the map before."""
        self._last = None
        self._inputs.lag.restart()

    def message(self, stamp: Time) -> DiagnosticArray:
        """The state at this moment."""
        now = time.monotonic()
        drops = self._all_drops()
        for line in self._drop_log.look(now, drops, self._inputs.examples):
            self._logger.warning(line)
        rates, behind = self._inputs.rates(), self._inputs.lateness()
        counts = {
            sensor: InputCounts(
                self._inputs.received[sensor],
                self._inputs.heard.get(sensor),
                self._inputs.losses()[sensor].total,
                drops.get(sensor, {}),
            )
            for sensor in rates
        }
        inputs = [
            self._input(now, sensor, rate, behind.get(sensor), counts[sensor])
            for sensor, rate in rates.items()
        ]
        flow = self._look_at_flow(now, counts)
        recent = self._events.recent(now, self._happened())
        checks = self._findings.status(self._name)
        parts = [*inputs, self._queue(flow, recent), self._map(drops, flow, recent), checks]
        return DiagnosticArray(header=Header(stamp=stamp), status=parts)

    def _look_at_flow(self, now: float, counts: Mapping[str, InputCounts]) -> Verdict | None:
        """Whether windows come out of what comes in."""
        if self._inputs.paused:
            self._flow.rest(now)
            return None
        heard = {sensor: item.heard for sensor, item in counts.items() if item.heard is not None}
        silent = now - max(heard.values(), default=now)
        if silent <= min((self._vitals[sensor].patience for sensor in heard), default=0.0):
            silent = 0.0
        return self._flow.look(now, self._inputs.received.total(), self._windows, silent)

    def _happened(self) -> dict[str, int]:
        return {
            'mapper_failures': self._worker.failures,
            'failed_windows': self._stats().get('failed_windows', 0),
        }

    def _stats(self) -> Mapping[str, Any]:
        return {} if self._last is None else self._last.stats

    def _all_drops(self) -> dict[str, dict[str, int]]:
        """Everything that was not used, by sensor and reason, wherever it was lost."""
        drops: dict[str, dict[str, int]] = {}
        for (sensor, reason), count in self._worker.all_drops().items():
            drops.setdefault(sensor, {})[reason] = count
        return drops

    def _input(
        self, now: float, sensor: str, rate: float, behind: float | None, counts: InputCounts
    ) -> DiagnosticStatus:
        losses = self._inputs.losses()[sensor]
        verdict = self._vitals[sensor].look(now, counts)
        level, message = LEVELS[verdict.level], verdict.message
        if self._inputs.paused:
            level, message = DiagnosticStatus.OK, 'paused'
        elif verdict.level is Level.OK:
            message = f'{rate:.1f} Hz'
            if behind is None:
                level, message = DiagnosticStatus.WARN, 'no usable message yet'
            elif behind > self._worker.config.window.lateness and sensor != GNSS:
                level, message = DiagnosticStatus.WARN, f'{behind:.1f} s behind'
        topic = self._inputs.topics[sensor]
        values = {
            'topic': topic,
            'received': counts.received,
            'rate_hz': round(rate, 2),
            'behind_s': behind,
            'reliability': self._inputs.reliabilities()[sensor],
            'lost_in_transport': losses.transport,
            'overwritten': losses.overwritten,
            'dropped': dict(counts.dropped),
        }
        return MESSAGES.status(f'{self._name}: {sensor}', level, message, values, hardware=topic)

    def _queue(self, flow: Verdict | None, recent: set[str]) -> DiagnosticStatus:
        core, imu = self._worker.inbox.waiting()
        shedding = self._worker.inbox.shedding()
        row = {} if self._last is None else self._last.result.row
        stats = self._stats()
        overloaded = shedding != NO_SHEDDING
        lag = max(self._inputs.lag.worst(), self._worker.inbox.delay())
        journal, missing = self._worker.journal_figures
        values = {
            'queue_core': core,
            'queue_imu': imu,
            'queue_mb': round(self._worker.inbox.nbytes() / MB, 2),
            'delay_s': round(self._worker.inbox.delay(), 2),
            'lag_s': round(lag, 2),
            'candidates_limit': shedding.candidates,
            'windows_merged_into_one': shedding.windows,
            'window_s': row.get('window_s', 0.0),
            **{f'{stage}_s': row.get(f'{stage}_s', 0.0) for stage in STAGES},
            'cut_windows': stats.get('cut_windows', 0),
            'limited_windows': self._worker.limited_windows,
            'merged_windows': stats.get('merged_windows', 0),
            'late_but_used': stats.get('late_but_used', 0),
            'real_time_factor': stats.get('real_time_factor', 0.0),
            'time_jumps': self._worker.jumps.jumps,
            'mapper_failures': self._worker.failures,
            'scans_mb': round(self._worker.scan_bytes / MB, 2),
            'scans_on_disk_mb': round(self._worker.disk_bytes / MB, 2),
            'journal_mb': round(journal / MB, 2),
            'journal_missing_windows': missing,
            'voxels_mb': round(self._worker.cloud_bytes / MB, 2),
            'peak_rss_mb': stats.get('peak_rss_mb', 0.0),
        }
        wrong: list[Verdict] = []
        if not self._worker.has_map:
            wrong.append(Verdict(Level.ERROR, 'no map could be begun; measurements are lost'))
        if flow is not None:
            wrong.append(flow)
        if 'mapper_failures' in recent:
            wrong.append(Verdict(Level.WARN, f'mapper failures: {self._worker.failures}'))
        if overloaded or lag > self._late:
            how = ': less search' if overloaded else ''
            wrong.append(Verdict(Level.WARN, f'falling behind{how}, {lag:.1f} s late'))
        level = LEVELS[max((item.level for item in wrong), default=Level.OK)]
        message = '; '.join(item.message for item in wrong) or 'keeps up'
        return MESSAGES.status(f'{self._name}: worker', level, message, values)

    def _map(
        self, drops: Mapping[str, Mapping[str, int]], flow: Verdict | None, recent: set[str]
    ) -> DiagnosticStatus:
        stats = self._stats()
        values = {key: stats.get(key, 0) for key in MAPPER_KEYS}
        values |= {
            'fixes_received': self._inputs.received[GNSS],
            'fixes_used': stats.get('factors_by_kind', {}).get(GNSS, 0),
            'fixes_rejected': dict(drops.get(GNSS, {})),
        }
        level, message = DiagnosticStatus.OK, 'connected' if values['clusters'] else 'no map yet'
        if values['bridges']:
            message = f'connected; {values["bridges"]} of {values["clusters"]} poses by a bridge'
        if values['components'] > 1:
            level, message = DiagnosticStatus.WARN, 'the graph is not connected'
        elif 'failed_windows' in recent:
            level, message = DiagnosticStatus.WARN, f'windows failed: {values["failed_windows"]}'
        elif flow is not None:
            level, message = DiagnosticStatus.WARN, f'does not grow: {flow.message}'
        return MESSAGES.status(f'{self._name}: map', level, message, values)
