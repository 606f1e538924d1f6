"""What a very long drive takes: memory, the cost of a window, and the final solve."""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from graph_memory import children, resident
from long_drive import RepeatedDrive

from incremental_mapper.config import Config
from incremental_mapper.datasets.source import Source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.statistics import peak_rss_mb


def hour(source: Source, config: Config, minutes: float) -> dict[str, Any]:
    """Map a drive that is repeated for so many minutes, its scans kept where the settings say.

    The growth is that of the processor's time that the mapper's thread takes for a window, which
    other programs on the machine disturb less than the time on the clock. Every minute of the drive
    a line goes to stderr: minutes, megabytes, those of all processes, seconds since the start.

    Args:
        source: A drive with its truth.
        config: Its settled settings.
        minutes: Rounded to whole rounds of the drive, one at the least.

    Returns:
        What is printed as JSON: megabytes, seconds, milliseconds of a window, counts.
    """
    rounds = max(round(60.0 * minutes / source.info.duration), 1)
    long = RepeatedDrive(source, rounds)
    mapper = Mapper(config, list(source.info.counts))
    began = time.perf_counter()
    held: list[tuple[float, float, float]] = []
    costs: list[float] = []
    spent, first = 0.0, 0
    for measurement in long.measurements():
        first = first or measurement.stamp
        begin = time.thread_time()
        windows = sum(bool(window.row['core']) for window in mapper.push(measurement))
        spent += time.thread_time() - begin
        if windows:
            costs += [spent / windows] * windows
            spent = 0.0
        if (minute := (measurement.stamp - first) / 6e10) >= len(held):
            held.append((minute, resident() / 1e6, proportional_mb()))
            now = time.perf_counter() - began
            print(
                *(f'{value:.1f}' for value in held[-1]), f'{now:.0f}', file=sys.stderr, flush=True
            )
    mapper.flush()
    mapped, mapping_s = peak_rss_mb(), time.perf_counter() - began
    own, everyone = np.array(held)[len(held) // 2 :, :2], max(item[2] for item in held)
    begin = time.process_time()
    result = mapper.result()
    final_s = time.perf_counter() - began - mapping_s
    tenth = max(len(costs) // 10, 1)
    return {
        'minutes': rounds * source.info.duration / 60.0,
        'peak_rss_mb_while_mapping': mapped,
        'all_processes_mb_while_mapping': everyone,
        'mb_a_minute': float(np.polyfit(*own.T, 1)[0]) if len(own) > 1 else float('nan'),
        'peak_rss_mb_with_final_solve': peak_rss_mb(),
        'final_s': final_s,
        'final_processor_s': time.process_time() - begin,
        'growth': float(np.mean(costs[-tenth:]) / np.mean(costs[:tenth])),
        'tenths_ms': [float(1e3 * np.mean(costs[i * tenth : (i + 1) * tenth])) for i in range(10)],
        'real_time_factor': rounds * source.info.duration / mapping_s,
        'clusters': len(result.clusters),
        'closures': dict(result.statistics.closures),
        'bridges': result.stats['bridges'],
        'carried': result.stats['carried_windows'],
        'solver_failures': result.stats['solver_failures'],
    }


def proportional_mb(process: int | str = 'self') -> float:
    """Megabytes that a process and all below it hold, what they share counted once."""
    try:
        lines = Path(f'/proc/{process}/smaps_rollup').read_text().splitlines()
    except OSError:
        return 0.0  # it has ended
    own = sum(1024 * int(line.split()[1]) for line in lines if line.startswith('Pss:'))
    return own / 1e6 + sum(proportional_mb(child) for child in children(process))
