"""Play a bag into the node and check that it maps as ``incremental_mapper map`` does.

    python examples/play_into_node.py BAG MAP_DIR OUT_DIR [--config YAML] [--rate R]

The node and the player run as programs of their own, in a ROS domain of this machine that nobody
else uses. This script is a client like any other: it listens to the node's topics and calls its
services. OUT_DIR is where the node saves; MAP_DIR is what ``map`` has made of the same bag with
the same settings. The exit status is 0 if the two graphs are equal, else 1.
"""

import argparse
import json
import math
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import PointCloud2

from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import InputError, MapperError
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import TOLERANCE, compare_graphs
from incremental_mapper.ros.client import Heard, NodeClient, open_client
from incremental_mapper.ros.programs import (
    free_domain,
    local_environment,
    node_command,
    player_command,
    running,
)
from incremental_mapper.ros.publishers import reliable
from incremental_mapper.settings import read_yaml

ATTEMPTS = 3
"""So often the bag is played, each time at half the rate, until the node keeps up."""
SHARE, FASTEST = 0.6, 4.0
"""Of the speed at which ``map`` ran so much is asked of the node, which publishes too."""
PATIENCE = 300.0
"""Seconds that the node has to answer a service: it maps what waits before."""
ARRIVAL = 60.0
"""Seconds that a program has to start, and what it sends to arrive."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play, where to save, and what to compare with."""

    bag: Path
    made_by_map: Path
    out: Path
    settings: tuple[Path, ...]
    counts: dict[str, int]
    duration: float


def main(argv: list[str] | None = None) -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('bag', type=Path, metavar='BAG')
    parser.add_argument('made_by_map', type=Path, metavar='MAP_DIR')
    parser.add_argument('out', type=Path, metavar='OUT_DIR')
    parser.add_argument('--config', type=Path, metavar='YAML', help='settings that map was given')
    parser.add_argument('--rate', type=float, help='times real time (default: what map could do)')
    args = parser.parse_args(argv)
    # A program that is asked to end takes node and player with it.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        tree = {} if args.config is None else read_yaml(args.config)
        info = open_source(args.bag, tree).info
        files = [args.bag / SETTINGS_FILE, *([args.config] if args.config else [])]
        wanted = Wanted(
            bag=args.bag,
            made_by_map=args.made_by_map,
            out=args.out,
            settings=tuple(path for path in files if path.is_file()),
            counts=dict(info.counts),
            duration=info.duration,
        )
        return compare(wanted, args.rate or fitting_rate(args.made_by_map))
    except MapperError as error:
        print(f'{Path(__file__).name}: {error}', file=sys.stderr)
        return 1


def fitting_rate(made_by_map: Path) -> float:
    """A rate that does not overload this machine, by how fast ``map`` was on it."""
    path = made_by_map / 'stats.json'
    try:
        possible = SHARE * json.loads(path.read_text())['real_time_factor']
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f'{path}: cannot be read; run "map" first ({error})') from error
    return min(math.floor(possible), FASTEST) if possible >= 1 else round(max(possible, 0.1), 1)


def compare(wanted: Wanted, rate: float) -> int:
    """Play until the node keeps up, then compare; returns the exit status."""
    for _ in range(ATTEMPTS):
        saved = play(wanted, rate)
        if saved is not None:
            break
        say('overload', 'the node could not keep up and searched less; again at half the rate')
        rate /= 2
    else:
        say('failed', f'the node does not keep up at {2 * rate:g} times real time either')
        return 1
    return tell(saved, wanted.made_by_map)


def tell(saved: Path, made_by_map: Path) -> int:
    """Say whether two saved maps have the same graph; returns the exit status."""
    found = compare_graphs(FinishedRun(saved).graph, FinishedRun(made_by_map).graph)
    for difference in found.differences:
        say('DIFFERENT', difference)
    if found.differences:
        return 1
    saved = saved.relative_to(Path.cwd()) if saved.is_relative_to(Path.cwd()) else saved
    say('equal', f'{saved} holds the same graph as {made_by_map}, which map made:')
    say('', f'{found.clusters} clusters, {found.variables} variables, {found.factors} factors,')
    say('', f'largest difference of a number {found.worst:.1g} (allowed {TOLERANCE:g})')
    return 0


def play(wanted: Wanted, rate: float) -> Path | None:
    """Play once into a new node; returns the folder it saved, None if it could not keep up."""
    domain = free_domain()
    environment = local_environment(domain)
    log_path = wanted.out.with_suffix('.log')
    log_path.parent.mkdir(parents=True, exist_ok=True)
    say('node', f'started as a program of its own, ROS domain {domain}; it logs to {log_path}')
    command = node_command(wanted.settings, {'save.folder': wanted.out.absolute()})
    with (
        log_path.open('w') as log,
        running(command, environment, stdout=log, stderr=log) as node,
        open_client(domain) as client,
    ):
        try:
            client.wait(
                lambda: bool(client.diagnostics), 'the node', ARRIVAL, lambda: node.poll() is None
            )
            return follow(wanted, rate, client, environment)
        except MapperError as error:
            *_, last = ['nothing', *log_path.read_text().splitlines()]
            raise InputError(f'{error}; the last that the node logged: {last}') from error


def follow(
    wanted: Wanted, rate: float, client: NodeClient, environment: dict[str, str]
) -> Path | None:
    """Play into a node that runs, and do with it what a client can; as ``play``."""
    maps: list[Heard] = []
    paths: list[Heard] = []
    latched = reliable(1, latched=True)
    client.listen('/incremental_mapper/map', PointCloud2, maps.append, latched)
    client.listen('/incremental_mapper/path', PathMessage, paths.append, latched)

    say('player', f'plays {wanted.duration:.1f} s of driving at {rate:g} times real time')
    command = player_command(wanted.bag, '--rate', rate, '--wait', ARRIVAL)
    with running(command, environment, stdout=subprocess.PIPE) as player:
        told, _ = player.communicate()
    if player.returncode != 0:
        raise InputError(f'the player ended with status {player.returncode}')
    say('', told.strip().removeprefix(f'{wanted.bag}: '))
    report_arrival(wanted, client)
    say('flush', client.call('flush', PATIENCE)[1])

    def shown() -> bool:
        newest = [
            heard[-1].message.header.stamp for heard in (client.odometry, paths, maps) if heard
        ]
        return len(newest) == 3 and all(stamp == newest[0] for stamp in newest)

    client.wait(shown, 'path and map of the newest window', ARRIVAL)
    say('client', f'heard {len(client.odometry)} messages on ~/odometry, one a window,')
    say('', f'a ~/path of {len(paths[-1].message.poses)} poses')
    say('', f'and a ~/map of {maps[-1].message.width} points')
    success, message = client.call('save_map', PATIENCE)
    if not success:
        raise InputError(message)
    say('save_map', message)
    worker = client.fresh_diagnostics()['worker']
    if worker['limited_windows'] or worker['merged_windows']:
        return None
    return Path(message.removeprefix('saved to ').partition(';')[0])


def report_arrival(wanted: Wanted, client: NodeClient) -> None:
    """Wait until the node has everything, and say so; raises InputError where it has not."""

    def received() -> dict[str, int]:
        parts = client.fresh_diagnostics()
        return {sensor: parts[sensor]['received'] for sensor in wanted.counts}

    try:
        client.wait(lambda: received() == wanted.counts, 'all messages', ARRIVAL)
    except InputError as error:
        raise InputError(f'{wanted.counts} messages played, {received()} received') from error
    say('arrived', ', '.join(f'{count} of {name}' for name, count in wanted.counts.items()))


def say(what: str, text: str) -> None:
    """One aligned line."""
    print(f'{what:<9} {text}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
