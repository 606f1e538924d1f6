"""The node: subscriptions in, one worker that maps, publishers and services out."""

import signal
import sys

if __name__ == '__main__':
    # To load the rest takes a second or two, and there is nothing to save yet.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import threading
from collections import Counter, deque
from collections.abc import Callable, Generator
from itertools import count
from typing import Any

try:
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.callback_groups import ReentrantCallbackGroup
    from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
    from rclpy.context import Context
    from rclpy.duration import Duration
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from rclpy.qos import QoSProfile
    from rclpy.signals import SignalHandlerOptions
    from rclpy.task import Future
    from std_srvs.srv import SetBool, Trigger
except ImportError as error:
    from incremental_mapper.ros.programs import without_ros

    raise without_ros(error, __name__) from error

from incremental_mapper.config import Tree
from incremental_mapper.errors import ConfigError, MapperError
from incremental_mapper.garbage import search_little
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.load_shedding import NO_SHEDDING
from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.ros.arguments import read_own_arguments
from incremental_mapper.ros.drop_log import AGAIN
from incremental_mapper.ros.health import Health
from incremental_mapper.ros.imu_odometry import make_imu_odometry
from incremental_mapper.ros.inbox import Command, Deadline, Order, Renewal
from incremental_mapper.ros.input_watch import InputWatch, published_by_others
from incremental_mapper.ros.known_findings import KnownFindings
from incremental_mapper.ros.live_extrinsics import (
    LiveExtrinsics,
    all_given,
    listen_to_transforms,
)
from incremental_mapper.ros.namesakes import Namesakes
from incremental_mapper.ros.parameters import NodeParameters
from incremental_mapper.ros.programs import NODE_NAME
from incremental_mapper.ros.publishers import Outputs, node_name
from incremental_mapper.ros.subscriptions import Inputs
from incremental_mapper.ros.updates import (
    News,
    Reply,
    Restarted,
    Retimed,
    Trouble,
    Update,
    ViewUpdate,
    WindowUpdate,
)
from incremental_mapper.ros.worker import SWITCH, Worker
from incremental_mapper.settings import merge

TICK = 0.1
"""Seconds between two looks at what is due, and the longest wait for a signal."""
ARRIVAL_LIMIT = 1.0
"""Seconds for which a flush lets messages come in that were sent before it."""


class _NextCycle:
    """Awaiting it lets the executor look at everything that is ready once more."""

    def __await__(self) -> Generator[None, None, None]:
        yield


class MapperNode:
    """Puts the parts together; everything but the worker runs in the executor's thread.

    Raises ConfigError where a parameter is unknown or its value is refused.
    """

    def __init__(
        self,
        context: Context | None = None,
        cli_args: list[str] | None = None,
        parameter_overrides: list[Parameter] | None = None,
    ) -> None:
        """Make the node and its worker; nothing is received before ``spin``.

        Args:
            context: rclpy's, which was initialised; None takes the default one.
            cli_args: as on the command line, such as ``['--ros-args', '-p', 'graph.lag:=5.0']``.
            parameter_overrides: the same as rclpy's parameters.
        """
        self._context = context or rclpy.get_default_context()
        self.node = Node(
            NODE_NAME,
            context=self._context,
            cli_args=cli_args,
            parameter_overrides=parameter_overrides,
            automatically_declare_parameters_from_overrides=True,
        )
        try:
            self.parameters = NodeParameters(self.node)
        except ConfigError:
            self.node.destroy_node()
            raise
        self._updates: deque[Update] = deque()
        self._futures: dict[int, Future] = {}
        self._tickets = count(1)
        self._stopping = False
        self._overload_told = Deadline(0.0)
        config = self.parameters.config
        self._logger = self.node.get_logger()
        self._findings = KnownFindings(self._logger)
        self._guard = self.node.create_guard_condition(self._on_updates)
        self._worker = Worker(config, self._take_update)
        try:
            self._inputs = Inputs(self.node, config, self._on_measurement)
        except ConfigError:
            self.node.destroy_node()
            raise
        # By when they reached the middleware: a machine that is busy leaves messages there.
        self._worker.inbox.clock = lambda: self._inputs.moment
        self._watch = InputWatch(self._inputs.topics, config.lidars)
        self._namesakes = Namesakes(self.node)
        self._extrinsics = self._make_extrinsics()
        self._worker.save_settings = lambda: self.parameters.config.save
        self._worker.outside_drops = self._outside_drops
        self._outputs = Outputs(self.node, self.parameters, self._worker.inbox)
        self._predicted = make_imu_odometry(self.node, config)
        self._worker.outside_findings = self._findings.lasting
        self._health = Health(
            node_name(self.node), self._inputs, self._worker, self._findings, self._logger
        )
        self._diagnostics = self.node.create_publisher(
            DiagnosticArray, '/diagnostics', QoSProfile(depth=10)
        )
        self._offer_services()
        # On the node's own clock timers would stand still until somebody publishes /clock.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.node.create_timer(TICK, self._on_tick, clock=steady)
        self.node.create_timer(config.diagnostics.period, self._on_diagnostics, clock=steady)
        self._jump_handle = self.node.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None,
                min_backward=Duration(seconds=-config.time_jump.threshold),
                on_clock_change=False,
            ),
            post_callback=self._on_clock_jump,
        )
        self._worker.start()
        topics = ', '.join(self._inputs.topics.values())
        self._logger.info(f'listening on {topics}')

    def spin(self, stop: Callable[[], bool], hurry: Callable[[], bool] = lambda: False) -> bool:
        """Work until ``stop`` says so or the context is shut down, then finish what is open.

        Args:
            stop: Ends the work.
            hurry: Ends the waiting for pictures, too, which are then made without the node.

        Returns:
            Whether every map that was to be saved is saved as it should be.
        """
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self.node)
        try:
            while not stop() and self._context.ok():
                executor.spin_once(TICK)
            self._begin_stop()
            # Publishers and services go on while the worker finishes.
            while self._worker.running() and self._context.ok():
                executor.spin_once(TICK)
                if hurry():
                    self._worker.saves.hurry.set()
        except ExternalShutdownException:
            self._begin_stop()
        self._worker.join()
        if self._context.ok():
            self._on_updates()
            # Whoever waits for a service gets the answer that came last.
            executor.spin_once(0.0)
        executor.shutdown()
        self._inputs.close()
        self.node.destroy_node()
        return self._worker.saves.failed == 0

    def _begin_stop(self) -> None:
        if not self._stopping:
            self._stopping = True
            self._inputs.paused = True
            self._worker.begin_stop(self.parameters.config.queue.shutdown_timeout)

    def _take_update(self, update: Update) -> None:
        """Called by the worker: hand an update to the executor's thread."""
        self._updates.append(update)
        if self._context.ok():
            self._guard.trigger()
        elif isinstance(update, Trouble):
            sys.stderr.write(f'{NODE_NAME}: {update.message}\n')

    def _on_updates(self) -> None:
        while self._updates:
            update = self._updates.popleft()
            if isinstance(update, PoseUpdate):
                self._outputs.pose(update)
                if self._predicted is not None:
                    self._predicted.pose(update)
            elif isinstance(update, WindowUpdate):
                self._outputs.window(update)
                self._health.window(update)
                self._findings.of_map(update.findings)
            elif isinstance(update, ViewUpdate):
                self._outputs.view(update)
            elif isinstance(update, Restarted):
                if update.reason:
                    self._logger.warning(f'a new map begins: {update.reason}')
                self._inputs.restart(update.config)
                if self._predicted is not None:
                    self._predicted.restart(update.config)
                self._health.restart()
                self._findings.of_map(update.findings, told=True)
                self._outputs.clear()
            elif isinstance(update, Retimed):
                self._logger.warning(f'the map goes on with other stamps: {update.reason}')
                self._inputs.restart(update.config)
                if self._predicted is not None:
                    self._predicted.retime(update.config)
            elif isinstance(update, Reply):
                future = self._futures.pop(update.ticket, None)
                if future is not None:
                    future.set_result(update)
            elif isinstance(update, News):
                self._logger.info(update.message)
            else:
                self._logger.warning(update.message)

    def _mend_inputs(self) -> None:
        """Tell what clocks and clouds show; where settings mend them, a new map begins."""
        steps = self._worker.jumps.steps
        followed = {name for name, step in steps.items() if step.followed}
        found = (*self._inputs.findings(followed), *self._watch.mended())
        self._findings.add(item for item in found if not item.changes)
        mended = tuple(item for item in found if item.changes)
        if mended:
            settings: Tree = {}
            for item in mended:
                settings = merge(settings, item.settings)
            reason = '; '.join(item.line() for item in mended)
            self._worker.inbox.put(Renewal(settings, reason, mended))

    def _on_measurement(self, measurement: Measurement, frame: str) -> None:
        if self._watch.take(measurement, frame):
            if self._predicted is not None:
                self._predicted.take(self._worker.jumps.moved(measurement))
            self._extrinsics.take(measurement, frame)

    def _outside_drops(self) -> Drops:
        """What was lost before the worker; any thread may ask."""
        outside = Counter(dict(self._watch.drops)) + Counter(dict(self._extrinsics.drops))
        return self._inputs.drops() + outside

    def _make_extrinsics(self) -> LiveExtrinsics:
        """Where the sensors are: by parameters, else by transforms, where those can be heard."""
        given, config = self.parameters.given, self.parameters.config
        open_places = not all_given(given, config)
        extrinsics = LiveExtrinsics(
            given, config, self._worker.inbox.put, self._logger.info, waiting=open_places
        )
        moving = extrinsics.moving if open_places else None
        if not listen_to_transforms(self.node, self._on_static, moving):
            extrinsics.wait_no_more()
            if open_places:
                self._logger.info(
                    'tf2_msgs is not installed: T_base_sensor comes from the parameters only'
                )
        return extrinsics

    def _on_static(self, message: Any) -> None:
        self._extrinsics.static(message)
        if self._outputs.transforms is not None:
            self._outputs.transforms.shared.static(message)

    def _look_at_inputs(self) -> None:
        """Ask what is wrong with the inputs by now."""
        topics = published_by_others(self.node) if self._watch.silent else {}
        self._watch.look_at_topics(self._inputs.types, self._topic_keys, topics)
        self._findings.of_part('inputs', self._watch.findings(self._topic_keys))
        self._findings.of_part('places', self._extrinsics.findings)
        self._findings.of_part('transport', self._inputs.of_transport())
        self._findings.of_part('clocks', self._worker.clock_steps)
        self._findings.of_part('namesakes', self._namesakes.findings())
        self._findings.of_part('frames', self._outputs.shared_frames())

    @property
    def _topic_keys(self) -> dict[str, str]:
        """The parameters that name the sensors' topics."""
        lidars = self.parameters.config.lidars
        return {
            name: f'lidars.{name}.topic' if name in lidars else f'{name}.topic'
            for name in self._inputs.topics
        }

    def _on_tick(self) -> None:
        self._inputs.look()
        self._extrinsics.look()
        self._mend_inputs()
        self._worker.graph_span = self.parameters.config.graph.markers_span
        self._outputs.tick()
        self._outputs.sensors(self._extrinsics.untold())
        overloaded = self._worker.inbox.shedding() != NO_SHEDDING
        if overloaded and self._overload_told.passed():
            # A machine at its limit comes and goes there several times a minute.
            self._overload_told = Deadline(AGAIN)
            self._logger.warning(
                'measurements come faster than they are mapped: fewer candidates are tried, then '
                'windows are merged, then scans left out; slow the input down or lower '
                'selection.max_candidates'
            )

    def _on_diagnostics(self) -> None:
        self._look_at_inputs()
        stamp = self.node.get_clock().now().to_msg()
        message = self._health.message(stamp)
        if self._predicted is not None:
            message.status = [*message.status, self._predicted.status()]
        self._diagnostics.publish(message)

    def _on_clock_jump(self, jump: TimeJump) -> None:
        self._worker.jumps.clock_jumped()

    def _offer_services(self) -> None:
        # The answers are awaited, and must not keep other callbacks from running meanwhile.
        group = ReentrantCallbackGroup()
        for order in (Order.SAVE, Order.RESET, Order.FLUSH):
            self.node.create_service(
                Trigger, f'~/{order}', self._obeys(order), callback_group=group
            )
        self.node.create_service(SetBool, '~/pause', self._on_pause, callback_group=group)

    def _obeys(self, order: Order) -> Callable[[Any, Any], Any]:
        async def on_request(request: Any, response: Any) -> Any:
            if self._stopping:
                response.message = 'the node is shutting down'
                return response
            if order is Order.FLUSH:
                await self._arrived()
            ticket = next(self._tickets)
            self._futures[ticket] = Future()
            self._worker.inbox.put(Command(order, ticket))
            reply: Reply = await self._futures[ticket]
            response.success, response.message = reply.success, reply.message
            return response

        return on_request

    async def _arrived(self) -> None:
        """Let the messages that wait in the middleware come in first, for a limited time."""
        limit = Deadline(ARRIVAL_LIMIT)
        before = -1
        while self._inputs.received.total() != before and not limit.passed():
            before = self._inputs.received.total()
            await _NextCycle()
            await _NextCycle()

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._inputs.paused = request.data or self._stopping
        response.success = True
        response.message = 'paused: measurements are left out' if request.data else 'running'
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Args:
        args: The program and its arguments; None takes those of this process.

    Returns:
        The exit status: 1 where the node cannot start, or a map is not saved as it should be.
    """
    words = sys.argv if args is None else args
    read_own_arguments(words[1:])
    search_little()
    sys.setswitchinterval(SWITCH)
    wanted, again = threading.Event(), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: (again if wanted.is_set() else wanted).set())
    try:
        saved = _start(args).spin(wanted.is_set, again.is_set)
    except MapperError as error:
        print(f'{NODE_NAME}: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0 if saved else 1


def _start(args: list[str] | None) -> MapperNode:
    """The node, from the program's arguments; raises ConfigError where they are wrong."""
    try:
        # Our own handlers leave the context alive, so that the last windows can be published.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        return MapperNode()
    # A parameter file, argument or type of a value that rclpy cannot read.
    except (RuntimeError, ValueError) as error:
        reason = ' '.join(str(error).split())
        if 'PARAMETER_NOT_SET' in reason:
            reason = 'one of them is an empty list, which has no type in ROS; leave its name out'
        raise ConfigError(f'arguments or parameters cannot be used: {reason}') from error


if __name__ == '__main__':
    sys.exit(main())
