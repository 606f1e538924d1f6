"""Diagnostics that tell when inputs die, are rejected, or lead to no window."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_msgs.msg import Header

from incremental_mapper.ros.programs import free_domain, local_environment, node_command, running
from incremental_mapper.ros.publishers import reliable
from incremental_mapper.ros.rclpy_types import MESSAGES
from robot_rows import Seen, row

PERIOD = 1.0
"""Seconds from diagnostics to diagnostics: the default."""
START = 60.0
"""Seconds that the node has to start and to be well."""
NAMESPACE = '/robot1'
OK = b'\x00'


@dataclass(slots=True)
class Robot:
    """Sensors of a standing robot in a room, and what the node's diagnostics say."""

    node: Node
    seen: list[tuple[float, DiagnosticArray]] = field(default_factory=list)
    sends: dict[str, bool] = field(
        default_factory=lambda: dict.fromkeys(('left', 'imu', 'fix'), True)
    )
    frozen: int = 0
    empty: bool = False
    _publishers: dict[str, Any] = field(default_factory=dict)
    _walls: Any = None

    def open(self) -> None:
        """Make the publishers and listen."""
        quality = reliable(50)
        kinds = {'points_left': PointCloud2, 'imu': Imu, 'fix': NavSatFix}
        self._publishers = {
            name: self.node.create_publisher(kind, f'{NAMESPACE}/{name}', quality)
            for name, kind in kinds.items()
        }
        self.node.create_subscription(
            DiagnosticArray,
            '/diagnostics',
            lambda message: self.seen.append((time.monotonic(), message)),
            QoSProfile(depth=100),
        )
        rng = np.random.default_rng(1)
        sides = [rng.uniform(-10, 10, (2000, 3)) * [1, 1, 0.2] for _ in range(3)]
        sides[0][:, 0], sides[1][:, 1], sides[2][:, 2] = 10.0, 10.0, -2.0
        self._walls = np.concatenate(sides)
        for name, rate, send in (
            ('left', 10.0, self._cloud),
            ('imu', 100.0, self._sample),
            ('fix', 1.0, self._fix),
        ):
            self.node.create_timer(1.0 / rate, self._sender(name, send))

    def pass_time(self, seconds: float, until: Callable[[], bool] = lambda: False) -> float:
        """Let time pass, until something holds; returns how many seconds it took."""
        begin = time.monotonic()
        while time.monotonic() - begin < seconds and not until():
            rclpy.spin_once(self.node, executor=self._executor(), timeout_sec=0.02)
        return time.monotonic() - begin

    def levels(self) -> dict[str, tuple[bytes, str]]:
        """Level and message of each part in the newest diagnostics."""
        if not self.seen:
            return {}
        return {
            item.name.partition(': ')[2]: (item.level, item.message)
            for item in self.seen[-1][1].status
        }

    def well(self) -> bool:
        """Whether every part is OK; the checks' findings on a map last as long as the map."""
        levels = self.levels()
        return bool(levels) and all(
            level == OK for part, (level, _) in levels.items() if part != 'checks'
        )

    def broken(self, part: str) -> Callable[[], bool]:
        """Whether a part has become an ERROR."""
        return lambda: self.levels().get(part, (OK, ''))[0] == b'\x02'

    def _executor(self) -> Any:
        if 'executor' not in self._publishers:
            executor = rclpy.executors.SingleThreadedExecutor(context=self.node.context)
            executor.add_node(self.node)
            self._publishers['executor'] = executor
        return self._publishers['executor']

    def _sender(self, name: str, send: Callable[[Header], None]) -> Callable[[], None]:
        def on_time() -> None:
            if self.sends[name]:
                stamp: Time = MESSAGES.time(self.frozen or time.time_ns())
                send(Header(stamp=stamp, frame_id=name))

        return on_time

    def _cloud(self, header: Header) -> None:
        stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
        noise = np.random.default_rng(stamp).normal(0.0, 0.01, self._walls.shape)
        points = np.full((500, 3), np.nan) if self.empty else self._walls + noise
        self._publishers['points_left'].publish(MESSAGES.cloud(stamp, points, 'left'))

    def _sample(self, header: Header) -> None:
        message = Imu(header=header)
        rates = np.random.default_rng().normal(0.0, 1e-3, 6)
        turn, push = message.angular_velocity, message.linear_acceleration
        turn.x, turn.y, turn.z = rates[:3].tolist()
        push.x, push.y, push.z = (rates[3:] + [0.0, 0.0, 9.81]).tolist()
        message.orientation_covariance[0] = -1.0
        self._publishers['imu'].publish(message)

    def _fix(self, header: Header) -> None:
        east, north = (np.random.default_rng().normal(0.0, 1e-7, 2)).tolist()
        message = NavSatFix(header=header, latitude=37.4 + north, longitude=126.7 + east)
        message.altitude = 40.0 + east
        message.status.status = 2
        message.position_covariance = np.diag([0.01, 0.01, 0.04]).ravel()
        message.position_covariance_type = 2
        self._publishers['fix'].publish(message)


@contextmanager
def robot(folder: Path) -> Iterator[Robot]:
    """A node in a process of its own, in a namespace, with inputs that make it well."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    domain = free_domain()
    given = {'lidars.names': ['left']}
    command = [*node_command((), given), '-r', f'__ns:={NAMESPACE}']
    context = Context()
    with (
        (folder / 'node.log').open('w') as log,
        running(command, local_environment(domain), log, log) as process,
    ):
        rclpy.init(context=context, domain_id=domain)
        node = Node('robot', context=context, enable_rosout=False)
        made = Robot(node)
        made.open()
        try:
            made.pass_time(START, lambda: made.well() or process.poll() is not None)
            if not made.well():
                raise RuntimeError(f'the node is not well: {made.levels()}')
            # Of a sensor whose first message has just come nobody knows how often it sends.
            made.pass_time(3 * PERIOD)
            yield made
        finally:
            node.destroy_node()
            rclpy.try_shutdown(context=context)


def recovered(seen: Robot) -> float:
    """Seconds until all is well again."""
    seconds = seen.pass_time(20.0, seen.well)
    if not seen.well():
        raise RuntimeError(f'the node is not well again: {seen.levels()}')
    return seconds


@row('/diagnostics says OK and connected')
def all_inputs_dead(folder: Path) -> Seen:
    """All inputs die, and come back."""
    with robot(folder) as seen:
        seen.sends = dict.fromkeys(seen.sends, False)
        first = seen.pass_time(20.0, lambda: not seen.well())
        error = first + seen.pass_time(20.0, seen.broken('worker'))
        said = seen.levels()['worker'][1]
        seen.sends = dict.fromkeys(seen.sends, True)
        back = recovered(seen)
        ok = first <= 2 * PERIOD + 0.3 and error <= 4 * PERIOD and seen.well()
        text = f'not OK after {first:.1f} s, ERROR after {error:.1f} s ({said}), OK {back:.1f} s'
        return Seen(f'{text} after the return', ok)


@row('/diagnostics says OK and connected')
def lidar_rejected(folder: Path) -> Seen:
    """A LiDAR whose clouds are all without a finite point, and is well again."""
    with robot(folder) as seen:
        seen.empty = True
        error = seen.pass_time(20.0, seen.broken('left'))
        said = seen.levels()['left'][1]
        seen.empty = False
        back = recovered(seen)
        log = (folder / 'node.log').read_text()
        lines = [line for line in log.splitlines() if 'no_finite_points' in line]
        ok = error <= 2 * PERIOD + 0.3 and seen.well() and len(lines) == 1
        text = f'ERROR after {error:.1f} s ({said}), OK {back:.1f} s after the end'
        return Seen(f'{text}; {len(lines)} line in the log', ok)


@row('/diagnostics says OK and connected')
def one_input_dead(folder: Path) -> Seen:
    """The IMU dies, and comes back; the names have the namespace."""
    with robot(folder) as seen:
        names = {item.name.partition(': ')[0] for item in seen.seen[-1][1].status}
        seen.sends['imu'] = False
        warned = seen.pass_time(20.0, lambda: not seen.well())
        error = warned + seen.pass_time(20.0, seen.broken('imu'))
        said = seen.levels()['imu'][1]
        seen.sends['imu'] = True
        back = recovered(seen)
        named = names == {f'{NAMESPACE}/incremental_mapper'}
        ok = warned <= 2 * PERIOD + 0.3 and error <= 7.5 and seen.well() and named
        text = f'not OK after {warned:.1f} s, ERROR after {error:.1f} s ({said}), OK {back:.1f} s'
        return Seen(f'{text} after the return; {names}', ok)


@row('/diagnostics says OK and connected', long=True)
def no_window(folder: Path) -> Seen:
    """No window for a minute: all stamps stand still while messages come."""
    with robot(folder) as seen:
        seen.frozen = time.time_ns()
        first = seen.pass_time(30.0, lambda: not seen.well())
        error = first + seen.pass_time(60.0 - first, seen.broken('worker'))
        seen.pass_time(60.0 - error)
        said = seen.levels()['worker'][1]
        seen.frozen = 0
        recovered(seen)
        ok = error <= 10.0 and 'no window for' in said and seen.well()
        return Seen(f'not OK after {first:.1f} s, ERROR after {error:.1f} s; later: {said}', ok)
