"""Clouds that another process sends: how many of them the node receives."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from incremental_mapper.ros.client import open_client
from incremental_mapper.ros.programs import (
    free_domain,
    local_environment,
    node_command,
    running,
)
from robot_rows import Seen, row

SENDER = Path(__file__).parents[1] / 'cloud_sender.py'
PROFILE = Path(__file__).parents[2] / 'config' / 'fastdds_large_clouds.xml'
SENT = 60
PATIENCE = 60.0


def received(folder: Path, points: int, *options: str, **environment: str) -> dict[str, Any]:
    """What the node says of its LiDAR after another process has sent 60 clouds at 10 Hz."""
    ours = {**local_environment(free_domain()), **environment}
    parameters = {'lidars.names': '[top]', 'diagnostics.period': 0.5}
    words = [sys.executable, str(SENDER), '/points_top', '--points', str(points)]
    with (
        (folder / f'{points}.log').open('w') as log,
        running(node_command((), parameters), ours, log, log) as node,
        open_client(int(ours['ROS_DOMAIN_ID'])) as client,
    ):
        client.wait(
            lambda: bool(client.diagnostics), 'the node', PATIENCE, lambda: node.poll() is None
        )
        subprocess.run([*words, '--count', str(SENT), *options], env=ours, check=True)
        # Once the sender has gone, nothing is decided any more.
        decided = [
            parts['top']['reliability']
            for parts in client.diagnostics
            if parts['top']['reliability'] != 'undecided'
        ]
        client.fresh_diagnostics(PATIENCE)
        found = dict(client.fresh_diagnostics(PATIENCE)['top'])
        told = any(PROFILE.name in str(parts['checks']) for parts in client.diagnostics)
        reliability = decided[-1] if decided else 'undecided'
        return {**found, 'reliability': reliability, 'told': told}


def reliable(folder: Path, points: int) -> Seen:
    """All of a reliable publisher's clouds come."""
    part = received(folder, points)
    lost = part['lost_in_transport'] + part['overwritten']
    now = f'received {part["received"]} of {SENT}, {part["reliability"]}, {lost} counted as lost'
    return Seen(now, part['received'] == SENT and lost == 0)


@row('received 28')
def reliable_small(folder: Path) -> Seen:
    """60 clouds of 0.77 MB at 10 Hz from a reliable publisher."""
    return reliable(folder, 16_000)


@row('received 19')
def reliable_middle(folder: Path) -> Seen:
    """60 clouds of 3.15 MB at 10 Hz from a reliable publisher."""
    return reliable(folder, 65_536)


@row('received 6')
def reliable_large(folder: Path) -> Seen:
    """60 clouds of 6.3 MB at 10 Hz from a reliable publisher."""
    return reliable(folder, 131_072)


@row('losses without the cause')
def best_effort(folder: Path) -> Seen:
    """60 clouds of 0.77 MB at 10 Hz from a best-effort publisher: what is lost is told."""
    part = received(folder, 16_000, '--best-effort')
    now = (
        f'received {part["received"]} of {SENT}, {part["reliability"]}, '
        f'{part["lost_in_transport"]} counted as lost; '
        f'{"" if part["told"] else "not "}told with the remedy'
    )
    # The sender has 512 kB of shared memory: nothing that the receiver does helps.
    lost = part['received'] < SENT
    return Seen(now, part['reliability'] == 'best effort' and part['told'] == lost)


@row('the same')
def best_effort_with_room(folder: Path) -> Seen:
    """60 clouds of 6.3 MB from a best-effort publisher with config/fastdds_large_clouds.xml."""
    part = received(folder, 131_072, '--best-effort', FASTRTPS_DEFAULT_PROFILES_FILE=str(PROFILE))
    now = (
        f'received {part["received"]} of {SENT}, {part["reliability"]}, '
        f'{part["lost_in_transport"]} counted as lost'
    )
    return Seen(now, part['received'] == SENT)
