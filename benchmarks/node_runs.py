"""What the node's benchmarks share: a bag of a simulated drive, and a run of the two programs."""

import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

from incremental_mapper.cli.convert import convert
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.errors import InputError
from incremental_mapper.ros.client import NodeClient, open_client
from incremental_mapper.ros.programs import (
    free_domain,
    local_environment,
    node_command,
    player_command,
    running,
)
from incremental_mapper.settings import read_yaml

SEED = 5
KINDS = {'imu': Imu, 'gnss': NavSatFix}
RELIABLE = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
PATIENCE = 600.0
"""Seconds that an overloaded node has to map what waits."""
START = 120.0
"""Seconds that a program has to start: a node that was never run compiles first."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A bag, the settings files for it, and its messages by sensor."""

    bag: Path
    settings: tuple[Path, ...]
    counts: Mapping[str, int]
    seconds: float


@dataclass(slots=True)
class NodeRun:
    """A node that runs, its client, and what was made of it so far.

    ``player_said`` is the player's last line.
    """

    drive: Drive
    client: NodeClient
    pid: int
    environment: Mapping[str, str]
    player_said: str = ''
    topics: dict[str, str] = field(default_factory=dict)

    def play(self, rate: float, look: Callable[[], None] = lambda: None) -> None:
        """Play the whole bag; ``look`` is called a few times a second meanwhile."""
        command = player_command(self.drive.bag, '--rate', rate, '--wait', START)
        with running(command, self.environment, subprocess.PIPE, subprocess.DEVNULL) as player:
            while player.poll() is None:
                self.client.fresh_diagnostics()
                look()
            told, _ = player.communicate()
        if player.returncode != 0:
            raise InputError(f'the player ended with status {player.returncode}')
        self.player_said = told.strip().removeprefix(f'{self.drive.bag}: ')

    def parts(self) -> dict[str, dict[str, Any]]:
        """The node's next diagnostics by part."""
        return self.client.fresh_diagnostics(PATIENCE)

    def catch_up(self) -> None:
        """Wait until nothing waits for the mapper and nothing more comes."""
        before: dict[str, int] = {}
        while True:
            parts = self.parts()
            received = {name: parts[name]['received'] for name in self.drive.counts}
            waiting = parts['worker']['queue_core'] + parts['worker']['queue_imu']
            if received == before and waiting == 0:
                return
            before = received


def make_drive(work: Path, seconds: float, config: Path | None) -> Drive:
    """A simulated drive of that length at the rates of KAIST, made in ``work`` once."""
    name = f'mixed_{seconds:g}s'
    bag = work / f'{name}_bag'
    if not (bag / 'metadata.yaml').exists():
        print(f'simulating {seconds:g} s of driving into {bag} (once)', flush=True)
        folder = work / name
        simulate(
            folder,
            SimulationOptions(motion=MotionKind.MIXED, duration=seconds, seed=SEED, overwrite=True),
            None,
        )
        convert(folder, bag, force=True)
        rmtree(folder)
    tree = {} if config is None else read_yaml(config)
    info = open_source(bag, tree).info
    settings = (bag / SETTINGS_FILE, *([] if config is None else [config]))
    return Drive(bag, settings, dict(info.counts), info.duration)


@contextmanager
def node_run(drive: Drive, log: Path, parameters: Mapping[str, object]) -> Iterator[NodeRun]:
    """A node of its own for one run, in a ROS domain of this machine."""
    domain = free_domain()
    environment = local_environment(domain)
    # Looked at often, so that short states are seen.
    given = {'diagnostics.period': 0.2, **parameters}
    with (
        log.open('w') as file,
        running(node_command(drive.settings, given), environment, file, file) as node,
        open_client(domain) as client,
    ):
        client.wait(
            lambda: bool(client.diagnostics), 'the node', START, lambda: node.poll() is None
        )
        run = NodeRun(drive, client, node.pid, environment)
        run.topics = {name: run.parts()[name]['topic'] for name in drive.counts}
        yield run


def publishers(run: NodeRun) -> Mapping[str, Callable[[Any], None]]:
    """What publishes each sensor's messages, once the node listens."""
    node = run.client._node
    made = {
        sensor: node.create_publisher(KINDS.get(sensor, PointCloud2), topic, RELIABLE)
        for sensor, topic in run.topics.items()
    }
    run.client.wait(
        lambda: all(item.get_subscription_count() > 0 for item in made.values()),
        'the subscriptions of the node',
        START,
    )
    time.sleep(1.0)  # the other side of a match may take a little longer
    return {sensor: publisher.publish for sensor, publisher in made.items()}


def lost_table(run: NodeRun) -> str:
    """Markdown: messages of every topic that were played, that arrived, and that were left out."""
    parts = run.parts()
    rows = ['| topic | played | received | lost | left out by the node |', '|---|---|---|---|---|']
    for sensor, played in run.drive.counts.items():
        part = parts[sensor]
        dropped = ', '.join(f'{n} {reason}' for reason, n in part['dropped'].items()) or '0'
        lost = played - part['received']
        rows.append(f'| {part["topic"]} | {played} | {part["received"]} | {lost} | {dropped} |')
    return '\n'.join(rows)
