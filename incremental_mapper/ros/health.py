"""What /diagnostics tells: every input, the worker, the map, and what was found wrong."""

from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header

from incremental_mapper.mapping.load_shedding import NO_SHEDDING
from incremental_mapper.mapping.statistics import STAGES
from incremental_mapper.measurements import Drops
from incremental_mapper.ros.known_findings import KnownFindings
from incremental_mapper.ros.result_messages import status
from incremental_mapper.ros.subscriptions import GNSS, Inputs
from incremental_mapper.ros.updates import WindowUpdate
from incremental_mapper.ros.worker import Worker

MAPPER_KEYS = (
    'windows',
    'clusters',
    'vertices',
    'factors',
    'components',
    'bridges',
    'georeferenced',
    'failed_windows',
)
MB = 1e6


class Health:
    """Makes the diagnostics; used in the executor's thread only."""

    def __init__(self, name: str, inputs: Inputs, worker: Worker, findings: KnownFindings) -> None:
        self._name = name
        self._inputs = inputs
        self._worker = worker
        self._findings = findings
        self._last: WindowUpdate | None = None

    def window(self, update: WindowUpdate) -> None:
        """Remember the newest window."""
        self._last = update

    def restart(self) -> None:
        """Forget the map before."""
        self._last = None

    def message(self, stamp: Time) -> DiagnosticArray:
        """The state at this moment."""
        drops = self._all_drops()
        rates, behind = self._inputs.rates(), self._inputs.lateness()
        inputs = [
            self._input(sensor, rate, behind.get(sensor), drops.get(sensor, {}))
            for sensor, rate in rates.items()
        ]
        checks = self._findings.status(self._name)
        parts = [*inputs, self._queue(), self._map(drops), checks]
        return DiagnosticArray(header=Header(stamp=stamp), status=parts)

    def _stats(self) -> Mapping[str, Any]:
        return {} if self._last is None else self._last.stats

    def _all_drops(self) -> dict[str, dict[str, int]]:
        """Everything that was not used, by sensor and reason, wherever it was lost."""
        drops: dict[str, dict[str, int]] = {
            sensor: dict(reasons) for sensor, reasons in self._stats().get('dropped', {}).items()
        }
        outside: Drops = self._worker.drops()
        for (sensor, reason), count in outside.items():
            reasons = drops.setdefault(sensor, {})
            reasons[reason] = reasons.get(reason, 0) + count
        return drops

    def _input(
        self, sensor: str, rate: float, behind: float | None, drops: Mapping[str, int]
    ) -> DiagnosticStatus:
        received, losses = self._inputs.received[sensor], self._inputs.losses()[sensor]
        level, message = DiagnosticStatus.OK, f'{rate:.1f} Hz'
        if self._inputs.paused:
            message = 'paused'
        elif received == 0:
            level, message = DiagnosticStatus.WARN, 'no message yet'
        elif losses.total > 0:
            level, message = DiagnosticStatus.WARN, f'{losses.total} messages lost'
        elif behind is None:
            level, message = DiagnosticStatus.WARN, 'no usable message yet'
        elif behind > self._worker.config.window.lateness and sensor != GNSS:
            level, message = DiagnosticStatus.WARN, f'{behind:.1f} s behind'
        values = {
            'topic': self._inputs.topics[sensor],
            'received': received,
            'rate_hz': round(rate, 2),
            'behind_s': behind,
            'reliability': self._inputs.reliabilities()[sensor],
            'lost_in_transport': losses.transport,
            'overwritten': losses.overwritten,
            'dropped': dict(drops),
        }
        return status(f'{self._name}: {sensor}', level, message, values)

    def _queue(self) -> DiagnosticStatus:
        core, imu = self._worker.inbox.waiting()
        shedding = self._worker.inbox.shedding()
        row = {} if self._last is None else self._last.result.row
        stats = self._stats()
        overloaded = shedding != NO_SHEDDING
        values = {
            'queue_core': core,
            'queue_imu': imu,
            'queue_mb': round(self._worker.inbox.nbytes() / MB, 2),
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
            'voxels_mb': round(self._worker.cloud_bytes / MB, 2),
            'peak_rss_mb': stats.get('peak_rss_mb', 0.0),
        }
        level, message = DiagnosticStatus.OK, 'keeps up'
        if not self._worker.has_map:
            level, message = DiagnosticStatus.ERROR, 'no map could be begun; measurements are lost'
        elif self._worker.failures:
            level, message = DiagnosticStatus.WARN, f'mapper failures: {self._worker.failures}'
        elif overloaded:
            level, message = DiagnosticStatus.WARN, 'falling behind: less search'
        return status(f'{self._name}: worker', level, message, values)

    def _map(self, drops: Mapping[str, Mapping[str, int]]) -> DiagnosticStatus:
        stats = self._stats()
        values = {key: stats.get(key, 0) for key in MAPPER_KEYS}
        values |= {
            'fixes_received': self._inputs.received[GNSS],
            'fixes_used': stats.get('factors_by_kind', {}).get(GNSS, 0),
            'fixes_rejected': dict(drops.get(GNSS, {})),
        }
        level, message = DiagnosticStatus.OK, 'connected'
        if values['bridges']:
            message = f'connected; {values["bridges"]} of {values["clusters"]} poses by a bridge'
        if values['components'] > 1:
            level, message = DiagnosticStatus.WARN, 'the graph is not connected'
        elif values['failed_windows']:
            level, message = DiagnosticStatus.WARN, f'windows failed: {values["failed_windows"]}'
        return status(f'{self._name}: map', level, message, values)
