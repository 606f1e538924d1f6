"""Where the sensors sit, by transforms that are published, where the parameters do not say."""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.sensor_places import frame_renamed
from incremental_mapper.config import Config, Tree
from incremental_mapper.datasets.extrinsics import place_sensors
from incremental_mapper.datasets.sensor_settings import extrinsics_of
from incremental_mapper.datasets.static_transforms import (
    MOST_MESSAGES,
    MOVING_TOPIC,
    STATIC_TOPIC,
    FrameTree,
    StillTransforms,
    add_transform,
    clean,
    stamped_transforms,
)
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.measurements import Drops, Measurement
from incremental_mapper.ros.inbox import Item, Renewal
from incremental_mapper.settings import merge

PATIENCE = 1.0
"""Seconds from the first measurement for which the transforms are waited for; /tf_static is there
within a tenth, /tf has each transform twice after 20 to 200 ms."""
LONG_PATIENCE = 5.0
"""The same where a LiDAR has to be left out otherwise: what tells of the robot may start with the
drivers, or a little later."""

UNPLACED = 'unplaced'
"""Why clouds of a LiDAR are left out of which nobody tells where it is beside the others."""


class LiveExtrinsics:
    """Holds the first measurements back until it is known where their sensors are, or too late.

    Used in the executor's thread. Sensors whose place the parameters give are not waited for, and
    where all are given, or transforms cannot be listened to, nothing is held back.

    ``findings`` are what is wrong with the places by now; ``drops`` counts clouds of LiDARs that
    nobody places.
    """

    def __init__(
        self,
        settings: Mapping[str, Any],
        config: Config,
        hand_on: Callable[[Item], None],
        tell: Callable[[str], object],
        waiting: bool,
    ) -> None:
        """Make ready for the first measurement.

        Args:
            settings: The parameters that are given, as nested dictionaries.
            config: All settings.
            hand_on: Takes measurements and settings that were found, in order.
            tell: Takes a line for the log.
            waiting: Whether the first measurements are held back until transforms come.
        """
        self.findings: tuple[Finding, ...] = ()
        self._settings = settings
        self._lidars = tuple(config.lidars)
        self._hand_on = hand_on
        self._tell = tell
        self._base = clean(config.frames.base)
        self._tree = FrameTree(wanted=self._base)
        self._still = StillTransforms()
        self._static = False
        self._messages = 0
        self._frames: dict[str, str] = {}  # of the newest message of each sensor
        self._placed_by: dict[str, str] = {}  # the frame_id that told where it is
        self._applied: Tree = {}
        self._told: set[str] = set()
        self._left_out: frozenset[str] = frozenset()
        self._held: list[Measurement] = []
        self._open = not waiting
        self._alone = False  # nobody else will tell
        self.drops: Drops = Counter()
        self._since: float | None = None
        self._changed = False

    def static(self, message: Any) -> None:
        """Take a ``tf2_msgs/TFMessage`` of /tf_static."""
        self._static = True
        for edge, numbers in stamped_transforms(message):
            add_transform(self._tree, STATIC_TOPIC, edge, numbers)
        self._changed = True
        self._look()

    def moving(self, message: Any) -> bool:
        """Take one of /tf, of which only what stands still is used; False: that was the last."""
        self._messages += self._since is not None  # before, there is nothing to find out
        before = len(self._tree.edges)
        for edge, numbers in stamped_transforms(message):
            self._still.take(edge, numbers)
        self._still.add_to(self._tree)
        if len(self._tree.edges) > before:
            self._changed = True
            self._look()
        return self._messages < MOST_MESSAGES

    def take(self, measurement: Measurement, frame: str) -> None:
        """Take a measurement, and the frame_id of its message; it is handed on sooner or later."""
        if self._since is None:
            self._since = time.monotonic()
        if self._frames.get(measurement.sensor) != frame:
            self._frames[measurement.sensor] = frame
            self._changed = True
        if self._open and not self._changed:
            self._pass_on(measurement)
            return
        self._held.append(measurement)
        self._look()

    def look(self) -> None:
        """Hand on what was held back for long enough; to be called ten times a second."""
        if self._since is not None and (self._held or self._changed):
            self._look()

    def untold(self) -> dict[str, NDArray[np.float64]]:
        """T_base_sensor (4, 4) of the parameters by frame_id, where no transform tells it.

        Empty until others have had the time to tell.
        """
        if self._since is None or time.monotonic() - self._since < PATIENCE:
            return {}
        base = self._tree.base() or self._base
        places: dict[str, NDArray[np.float64]] = {}
        for sensor, frame in self._frames.items():
            given = extrinsics_of(self._settings, sensor, self._lidars)
            name = clean(frame)
            own = name in ('', base)
            if given is not None and not own and self._tree.between(base, name) is None:
                places.setdefault(name, pose_matrix(given))
        return places

    def wait_no_more(self) -> None:
        """No transforms will come."""
        self._open, self._alone = True, True

    def _look(self) -> None:
        if self._since is None:
            return
        over = time.monotonic() - self._since >= PATIENCE
        sources = [STATIC_TOPIC] * self._static
        sources += [MOVING_TOPIC] * (bool(self._tree.edges) and not self._static)
        frames, renamed = self._telling_frames()
        places = place_sensors(self._tree, sources, self._settings, frames, self._seen_lidars())
        found = places.settings
        first = not self._open
        lacking = bool(places.left_out) and time.monotonic() - self._since < LONG_PATIENCE
        if first and (lacking or not (over or self._all_placed(found))):
            return
        self._open = True
        if over or self._alone:
            self._left_out = frozenset(places.left_out)
        if over:
            self.findings = (*places.findings, *renamed)
            self._changed = False
        for note in places.notes:
            if note not in self._told and self._ripe(note):
                self._told.add(note)
                self._tell(note)
        self._apply(found, frames)
        for measurement in self._held:
            self._pass_on(measurement)
        self._held = []

    def _telling_frames(self) -> tuple[dict[str, str], list[Finding]]:
        """The frame_id by which to look for each sensor, and what is wrong with it.

        A driver that was started anew may name its frame otherwise: the sensor is where it was.
        """
        frames, renamed = dict(self._frames), []
        base = self._tree.base()
        for sensor, before in self._placed_by.items():
            now = frames[sensor]
            known = base is not None and self._tree.between(base, now) is not None
            if now != before and not known:
                frames[sensor] = before
                renamed.append(frame_renamed(sensor, before, now))
        return frames, renamed

    def _apply(self, found: Tree, frames: Mapping[str, str]) -> None:
        """Hand on the places that are not those of before."""
        places, before = _places(found), _places(self._applied)
        moved = [name for name, place in places.items() if place != before.get(name)]
        if not moved:
            return
        # Where the same frame has moved a little, or was wrong from the start, what is mapped is
        # as good as it was; a sensor that was at no place, or is at another one, is mapped wrong.
        optional = all(self._placed_by.get(name) == frames[name] for name in moved)
        self._applied = merge(self._applied, found)
        self._placed_by |= {name: frames[name] for name in places}
        be = 'is' if len(moved) == 1 else 'are'
        reason = f'transforms tell where {", ".join(moved)} {be}'
        self._hand_on(Renewal(found, reason, optional=optional))

    def _pass_on(self, measurement: Measurement) -> None:
        """Hand a measurement on, unless it is of a LiDAR that nobody places beside the others."""
        if measurement.sensor in self._left_out:
            self.drops[measurement.sensor, UNPLACED] += 1
        else:
            self._hand_on(measurement)

    def _seen_lidars(self) -> dict[str, float]:
        # How many points each has is not known yet: the first of the settings counts most.
        return {name: 0.0 for name in self._lidars if name in self._frames}

    def _all_placed(self, found: Tree) -> bool:
        """Whether every sensor has sent something, and somebody tells where it is."""
        known = {*_names(found), *_names(self._settings)}
        base = (clean(self._tree.base() or ''), self._base)
        known |= {name for name, frame in self._frames.items() if clean(frame) in base}
        everything = {*self._lidars, 'imu', 'gnss'}
        return everything <= known and everything <= self._frames.keys()

    def _ripe(self, note: str) -> bool:
        """Whether a note is worth a line: those on the parameters' own poses grow with sensors."""
        return not note.endswith('from the settings')


def listen_to_transforms(
    node: Node, static: Callable[[Any], None], moving: Callable[[Any], bool] | None
) -> bool:
    """Subscribe to the transforms that others publish.

    Args:
        node: Who listens.
        static: Takes the messages of /tf_static.
        moving: Takes those of /tf, until it returns False; None where they are not wanted.

    Returns:
        Whether it could be done: tf2_msgs is not among the wheels of PyPI.
    """
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return False

    def quality(durability: DurabilityPolicy) -> QoSProfile:
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=100,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=durability,
        )

    latched, passing = DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE
    node.create_subscription(TFMessage, STATIC_TOPIC, static, quality(latched))
    if moving is not None:

        def take(message: Any) -> None:
            if not moving(message):
                # Every message costs time, and there may be hundreds a second.
                node.destroy_subscription(subscription)

        subscription = node.create_subscription(TFMessage, MOVING_TOPIC, take, quality(passing))
    return True


def all_given(settings: Mapping[str, Any], config: Config) -> bool:
    """Whether the settings name the place of every sensor."""
    return {*config.lidars, 'imu', 'gnss'} <= {*_names(settings)}


def _names(settings: Mapping[str, Any]) -> list[str]:
    """Sensors whose T_base_sensor a tree of settings names."""
    return [*_places(settings)]


def _places(settings: Mapping[str, Any]) -> dict[str, Any]:
    """T_base_sensor by sensor, where a tree of settings names it."""
    lidars = settings.get('lidars', {})
    sections = {**(lidars if isinstance(lidars, Mapping) else {}), **settings}
    return {
        name: section['T_base_sensor']
        for name, section in sections.items()
        if isinstance(section, Mapping) and 'T_base_sensor' in section
    }
