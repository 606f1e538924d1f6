"""Latency, stamps that jump, and holes: a drive is published live, its messages changed."""

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from node_runs import PATIENCE, Drive, NodeRun, make_drive, node_run, publishers

from incremental_mapper.datasets.bag_files import open_bag
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import compare_graphs, graph_tree
from incremental_mapper.results.offline_run import map_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.ros.client import Heard
from incremental_mapper.ros.publishers import reliable
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory
from robot_rows import Seen, row

CONFIG = Path(__file__).parents[2] / 'config' / 'kaist.yaml'
SECONDS = 40.0
SENSORS = ('left', 'right', 'imu', 'gnss')
HOUR = 3600.0
WARM_UP = 20
"""Windows after which a user may count on the latency."""
_KEPT: list[TemporaryDirectory[str]] = []


@dataclass(frozen=True, slots=True)
class Sent:
    """A message: when it is published (s since the start), whose, its stamp (ns), its bytes."""

    at: float
    sensor: str
    stamp: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Live:
    """What came of a drive: errors, parts of the last diagnostics, latencies (ms), the folder.

    ``published`` is when the last message of each window was published, and ``worker`` what
    /diagnostics said: when it came (ns of the system's clock both), level and text.
    """

    ate: float
    parts: dict[str, dict[str, Any]]
    latencies: list[float]
    lost: int
    folder: Path
    published: list[int]
    worker: list[tuple[int, int, str]]


@cache
def drive() -> Drive:
    """The simulated drive that all rows share."""
    _KEPT.append(TemporaryDirectory(prefix='robot_clocks_'))
    return make_drive(Path(_KEPT[-1].name), SECONDS, CONFIG)


@cache
def messages() -> tuple[Sent, ...]:
    """Its messages in the order of recording."""
    source = open_source(drive().bag, read_yaml(CONFIG))
    sensors = {f'/points_{name}': name for name in ('left', 'right')}
    sensors |= {'/imu': 'imu', '/fix': 'gnss'}
    reader = open_bag(drive().bag)
    first, found = None, []
    wanted = [item for item in reader.connections if item.topic in sensors]
    for connection, logged, data in reader.messages(wanted):
        first = logged if first is None else first
        seconds, nanoseconds = np.frombuffer(data[4:12], dtype='<i4')
        stamp = int(seconds) * NANOSECONDS + int(nanoseconds)
        at = (logged - first) / NANOSECONDS
        found.append(Sent(at, sensors[connection.topic], stamp, bytes(data)))
    reader.close()
    assert source.info.counts
    return tuple(found)


def truth() -> Trajectory:
    """Where the car was."""
    found = open_source(drive().bag, read_yaml(CONFIG)).truth()
    if found is None:
        raise InputError('the simulated bag has no truth')
    return found


def restamped(item: Sent, seconds: float) -> Sent:
    """The message with another stamp."""
    stamp = item.stamp + round(seconds * NANOSECONDS)
    header = np.array(divmod(stamp, NANOSECONDS), dtype='<i4').tobytes()
    return replace(item, stamp=stamp, data=item.data[:4] + header + item.data[12:])


def live(
    folder: Path,
    sent: Sequence[Sent],
    parameters: dict[str, object] | None = None,
    moved: Callable[[Trajectory], Trajectory] = lambda trajectory: trajectory,
    beside: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> Live:
    """Publish messages to a node in real time, and save its map.

    Args:
        folder: Scratch.
        sent: In the order in which they are published.
        parameters: More of the node's.
        moved: The truth for the stamps that were published.
        beside: What goes on while they are published.
    """
    # What is not of time must not depend on the load of the machine.
    given = {
        'save.folder': str(folder / 'saved'),
        'save.pictures': False,  # another process, which outlives the row
        'queue.max_delay': 0.0,
        **(parameters or {}),
    }
    with node_run(drive(), folder / 'node.log', given) as run:
        heard: list[Heard] = []
        run.client.listen('/diagnostics', DiagnosticArray, heard.append, reliable(100))
        with beside():
            times = publish(run, sent)
        run.catch_up()
        seen = len(run.client.odometry)
        run.client.call('flush', PATIENCE)
        ok, told = run.client.call('save_map', PATIENCE)
        parts = run.parts()
        if not (folder / 'saved').exists():
            raise InputError(f'nothing was saved: {ok}, {told}')
        lost = len(sent) - sum(parts[name]['received'] for name in SENSORS)
        latencies, published = latencies_of(run, seen, times)
    saved = FinishedRun(folder / 'saved')
    errors = trajectory_errors(saved.trajectory, moved(truth()))
    return Live(
        float('nan') if errors is None else errors.ate_rmse_m,
        parts,
        latencies,
        lost,
        folder / 'saved',
        published,
        [
            (item.received, status.level[0], status.message)
            for item in heard
            for status in item.message.status
            if status.name.endswith(': worker')
        ],
    )


def publish(run: NodeRun, sent: Sequence[Sent]) -> dict[tuple[str, int], int]:
    """Publish when it is time; returns when (ns of the system's clock), by sensor and stamp."""
    send = publishers(run)
    times: dict[tuple[str, int], int] = {}
    start = time.monotonic()
    for item in sent:
        time.sleep(max(start + item.at - time.monotonic(), 0.0))
        times[item.sensor, item.stamp] = time.time_ns()
        send[item.sensor](item.data)
    return times


def latencies_of(
    run: NodeRun, seen: int, times: dict[tuple[str, int], int]
) -> tuple[list[float], list[int]]:
    """Milliseconds from a window's last message to its odometry; when that message came, ns."""
    bounds = {
        stats['stamp_ns']: (stats['window.start_ns'], stats['window.end_ns'])
        for stats in run.client.stats
        if stats['window.core']
    }
    ordered = sorted((stamp, at) for (_, stamp), at in times.items())
    stamps = [stamp for stamp, _ in ordered]
    found, published = [], []
    for heard in run.client.odometry[:seen]:
        stamp = heard.message.header.stamp
        window = bounds.get(stamp.sec * NANOSECONDS + stamp.nanosec)
        if window is None:
            continue
        inside = slice(*np.searchsorted(stamps, window))
        last = max((at for _, at in ordered[inside]), default=heard.received)
        found.append((heard.received - last) / 1e6)
        published.append(last)
    return found, published


@cache
def undisturbed() -> float:
    """Metres of ATE that the drive has as it is, live."""
    with TemporaryDirectory(prefix='robot_clocks_', ignore_cleanup_errors=True) as folder:
        return live(Path(folder), messages()).ate


def dropped(seen: Live) -> str:
    """What the node left out, by sensor and reason."""
    told = [
        f'{count} {name} {reason}'
        for name in SENSORS
        for reason, count in seen.parts[name]['dropped'].items()
        if count
    ]
    return ', '.join(told) or 'nothing'


def within(ate: float) -> bool:
    """Whether an ATE is within a tenth of that of the drive as it is, live."""
    return ate <= 1.1 * undisturbed()


@row('0.53 s')
def latency(folder: Path) -> Seen:
    """Latency to ~/odometry from the window's last message, KAIST rates, a fix a second."""
    seen = live(folder, messages(), {'queue.max_delay': 1.0})
    p50, p99 = np.percentile(seen.latencies, [50, 99])
    # Two seconds, in which the periods of the sensors are learnt and the map is laid into ENU.
    start, rest = seen.latencies[:WARM_UP], seen.latencies[WARM_UP:]
    steady = float(np.percentile(rest, 99))
    source = open_source(drive().bag, read_all())
    result = map_source(source, effective_config(source, read_all(), 'settings')).result
    graph = json.loads(json.dumps(graph_tree(result.clusters, result.factors, result.values)))
    same = compare_graphs(FinishedRun(seen.folder).graph, graph).differences
    late = seen.parts['worker']['late_but_used']
    return Seen(
        f'{len(seen.latencies)} windows: p50 {p50:.0f} ms, p99 {p99:.0f} ms; p99 {steady:.0f} ms '
        f'without the first {len(start)}, the worst of which took {max(start):.0f} ms; '
        f'{seen.lost} lost, left out: {dropped(seen)}, {late} late but used; '
        f'graph of map: {same if same else "the same"}',
        bool(p50 <= 80 and steady <= 150 and seen.lost == 0 and not same),
    )


def read_all() -> dict[str, Any]:
    """The settings of the drive."""
    tree: dict[str, Any] = {}
    for path in drive().settings:
        tree = merge(tree, read_yaml(path))
    return tree


def with_strays(strays: Sequence[tuple[str, float]]) -> Iterable[Sent]:
    """The drive where now and then one stamp of a sensor is so many seconds ahead."""
    left = list(strays)
    apart = SECONDS / (len(strays) + 1)
    for item in messages():
        due = left and item.at > apart * (len(strays) - len(left) + 1)
        if due and item.sensor == left[0][0]:
            yield restamped(item, left.pop(0)[1])
        else:
            yield item


@row('the whole map is discarded as a time jump')
def stray_stamps(folder: Path) -> Seen:
    """One IMU and one LiDAR stamp each that is 1.5 s, 10 s, 1 h, a year ahead, in one drive."""
    leaps = (1.5, 10.0, HOUR, 365 * 24 * HOUR)
    strays = [(sensor, ahead) for ahead in leaps for sensor in ('imu', 'left')]
    seen = live(folder, list(with_strays(strays)))
    jumps = seen.parts['worker']['time_jumps']
    counted = {sensor: seen.parts[sensor]['dropped'].get('stamp_leap', 0) for sensor in SENSORS}
    wanted = Counter(sensor for sensor, _ in strays)
    return Seen(
        f'{len(strays)} strays: {jumps} resets, ATE {seen.ate:.4f} m ({undisturbed():.4f} m as it '
        f'is), left out: {dropped(seen)}',
        jumps == 0
        and within(seen.ate)
        and all(counted[sensor] == wanted[sensor] for sensor in SENSORS),
    )


@row('map reset, and all other sensors are dropped as before_jump for the rest of the run')
def one_sensor_steps_back(folder: Path) -> Seen:
    """One LiDAR's clock steps back by 12 s for 10 s of the drive."""
    return stepped(folder, 25.0)


@row('left out for the rest of the run')
def one_sensor_steps_for_good(folder: Path) -> Seen:
    """One LiDAR's clock steps back by 12 s for the rest of the drive."""
    return stepped(folder, SECONDS)


def stepped(folder: Path, end: float) -> Seen:
    """One LiDAR's clock steps back by 12 s at second 15, until ``end``."""
    sent = [
        restamped(item, -12.0) if item.sensor == 'right' and 15 <= item.at < end else item
        for item in messages()
    ]
    seen = live(folder, sent)
    jumps = seen.parts['worker']['time_jumps']
    finding = seen.parts['checks'].get('clock_step right', 'not named')
    # A second of scans until the step is known.
    few = seen.parts['right']['dropped'].get('clock_step', 0) <= 12
    ok = jumps == 0 and few and within(seen.ate) and 'lidars.right.time_offset: 12.0' in finding
    return Seen(
        f'{jumps} resets, ATE {seen.ate:.4f} m ({undisturbed():.4f} m as it is), left out: '
        f'{dropped(seen)}; {finding}',
        ok,
    )


def with_hole(hole: float) -> list[Sent]:
    """The middle third of the drive is missing, and what comes then is ``hole`` seconds later."""
    begin, end = SECONDS / 3, 2 * SECONDS / 3
    kept = []
    for item in messages():
        if item.at < begin:
            kept.append(item)
        elif item.at >= end:
            later = restamped(item, hole - (end - begin))
            kept.append(replace(later, at=item.at - (end - begin) + 1.0))
    return kept


@row('the earlier map bends by 3.8 m, 14.9 m, 500 m', long=True)
def holes(folder: Path) -> Seen:
    """A hole of 20 s, 60 s, 600 s in all data, fixes every second after it (stamps only)."""
    told, ok = [], True
    begin, end = SECONDS / 3, 2 * SECONDS / 3
    for hole in (20.0, 60.0, 600.0):
        place = folder / f'{hole:g}'
        place.mkdir()
        first = min(item.stamp - round(item.at * NANOSECONDS) for item in messages()[:50])
        later = round((hole - (end - begin)) * NANOSECONDS)
        border = first + round((begin + end) / 2 * NANOSECONDS)

        def moved(trajectory: Trajectory, border: int = border, later: int = later) -> Trajectory:
            stamps = np.where(trajectory.stamps > border, trajectory.stamps + later, 0)
            stamps = np.where(stamps == 0, trajectory.stamps, stamps)
            return replace(trajectory, stamps=stamps)

        seen = live(place, with_hole(hole), moved=moved)
        parts = seen.parts['map']
        told.append(
            f'{hole:g} s: ATE {seen.ate:.3f} m, {parts["components"]} component, '
            f'{seen.parts["worker"]["time_jumps"]} resets, left out {dropped(seen)}'
        )
        ok = ok and seen.ate <= 0.1 and parts['components'] == 1
    return Seen('; '.join(told), ok)
