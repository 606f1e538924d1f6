"""Minutes of a 64-beam LiDAR through DDS: losses, real time, memory."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from graph_memory import children, resident

from incremental_mapper.ros.client import open_client
from incremental_mapper.ros.programs import (
    free_domain,
    local_environment,
    node_command,
    running,
)
from robot_rows import Seen, row
from robot_rows.inputs import PROFILE

SENDER = Path(__file__).parents[1] / 'drive_sender.py'
ROOM = {'FASTRTPS_DEFAULT_PROFILES_FILE': str(PROFILE)}
"""Shared memory for whole clouds, for the driver and the node, as the docs say."""
PATIENCE = 120.0
MB = 1e6
MOST_GROWTH = 5.0
"""MB a minute beyond the map: points of scans, voxels, what waits."""
NODE = {
    'lidars.names': '[top]',
    'lidars.top.T_base_sensor': '[0.0, 0.0, 1.8, 0.0, 0.0, 0.0, 1.0]',
    'imu.T_base_sensor': '[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]',
    'diagnostics.period': 1.0,
}


def drive(folder: Path, seconds: float) -> Seen:
    """Send that long, and see what the node says of it."""
    ours = {**local_environment(free_domain()), **ROOM}
    rows: list[tuple[float, float]] = []
    with (
        (folder / 'node.log').open('w') as log,
        running(node_command((), NODE), ours, log, log) as node,
        open_client(int(ours['ROS_DOMAIN_ID'])) as client,
        running(
            [sys.executable, str(SENDER), '--seconds', str(seconds)], ours, subprocess.PIPE
        ) as sender,
    ):
        waited, load, before = 0, 0.0, cpu_seconds(node.pid)
        while sender.poll() is None:
            parts: dict[str, Any] = client.fresh_diagnostics(PATIENCE)
            worker = parts['worker']
            waited = max(waited, worker['queue_core'])
            load = max(load, os.getloadavg()[0])
            if client.stats and client.stats[-1]['drive_s'] > 0:
                known = worker['scans_mb'] + worker['voxels_mb'] + worker['queue_mb']
                drive_s = client.stats[-1]['drive_s']
                rows.append((drive_s / 60.0, resident(node.pid) / MB - known))
        said = (sender.stdout.read() if sender.stdout else '').strip()
        client.call('flush', PATIENCE)
        used = (cpu_seconds(node.pid) - before) / seconds
        parts = client.fresh_diagnostics(PATIENCE)
        top, worker = parts['top'], parts['worker']
        poses = client.stats[-1]['clusters']
    late = np.array([item for item in rows if item[0] >= rows[-1][0] / 2.0])
    # A node that maps too slowly leaves nothing to fit a line to, which is no success.
    growth = float(np.polyfit(late[:, 0], late[:, 1], 1)[0]) if len(late) >= 5 else np.nan
    lost = top['lost_in_transport'] + top['overwritten']
    sent = round(10.0 * seconds)
    now = (
        f'{said}; received {top["received"]}, {lost} counted as lost, dropped {top["dropped"]}; '
        f'at most {waited} waited, {worker["merged_windows"]} windows merged, real-time factor '
        f'{worker["real_time_factor"]:.2f}, {used:.2f} s of processor a second; {poses} clusters; '
        'memory without scans, voxels and queue '
        f'{growth:+.1f} MB a minute in the second half; load of the machine up to {load:.1f}'
    )
    good = top['received'] == sent and not lost and not top['dropped']
    return Seen(now, good and worker['merged_windows'] == 0 and growth < MOST_GROWTH)


def cpu_seconds(pid: int) -> float:
    """Seconds of processor that a program and its children have used; not those of the load."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    own = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    return own + sum(cpu_seconds(child) for child in children(pid))


@row('not tried', long=True)
def minute(folder: Path) -> Seen:
    """A minute at 64 beams (2.4 MB a cloud, 10 Hz) and an IMU, fastdds_large_clouds.xml."""
    return drive(folder, 60.0)


@row('not tried', long=True)
def ten_minutes(folder: Path) -> Seen:
    """10 minutes at 64 beams (2.4 MB a cloud, 10 Hz) and an IMU, fastdds_large_clouds.xml."""
    return drive(folder, 600.0)
