"""Where the sensors sit on the car, by the settings and by the recording's transforms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.frame_names import shown_frame
from incremental_mapper.measurements import Vector

BASE_FRAME = 'base_link'
"""The car's frame (REP-105)."""
_AGREE_M, _AGREE_DEG = 0.1, 2.0
"""Metres and degrees by which settings and transforms may differ unsaid; two careful calibrations
of one car do."""
_SAME = 1e-6
"""Largest difference of two poses' numbers that is none."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorPlace:
    """What is known of where a sensor sits.

    Attributes:
        sensor: Its name.
        key: Its section of the settings, such as ``lidars.left`` or ``imu``.
        frame: The frame_id of its messages, without a slash in front; '' where it is not known.
        lidar: Whether it is a LiDAR.
        given: T_base_sensor (4, 4) by the settings, or None.
        static: The same by static transforms, or None; the identity in the car's own frame.
        points: Points a second, for LiDARs.
    """

    sensor: str
    key: str
    frame: str
    lidar: bool
    given: Vector | None = None
    static: Vector | None = None
    points: float = 0.0

    @property
    def known(self) -> Vector | None:
        """T_base_sensor (4, 4) as far as anybody tells: the settings come first."""
        return self.static if self.given is None else self.given


def unplaced_lidars(places: Sequence[SensorPlace]) -> list[str]:
    """Tell which LiDARs make a wrong map, because nobody tells where they are beside another one.

    Two LiDARs at unknown places, taken for one place, are matched well each for itself and against
    each other at every step: 2.3 m of ATE where one alone has 0.28 m, its IMU being at
    an unknown place too. Where IMU or receiver share the LiDARs' frame, all were moved there.

    Args:
        places: All sensors.

    Returns:
        Names of the LiDARs that are better left out: all whose place nobody tells, but the one
        with the most points where that is all of them.
    """
    lidars = [place for place in places if place.lidar]
    common = {place.frame for place in places if place.frame and not place.lidar}
    unplaced = [place for place in lidars if place.known is None and place.frame not in common]
    if unplaced and len(unplaced) == len(lidars):
        unplaced.remove(max(unplaced, key=lambda place: place.points))
    return [place.sensor for place in unplaced]


def lidars_left_out(places: Sequence[SensorPlace]) -> list[Finding]:
    """The same as findings, for whoever leaves them out."""
    out = unplaced_lidars(places)
    kept = [place.sensor for place in places if place.lidar and place.sensor not in out]
    return [
        Finding(
            'lidar_left_out',
            Severity.WARNING,
            place.sensor,
            'neither the settings nor /tf_static tell where it is (frame '
            f'{shown_frame(place.frame)}) beside {", ".join(kept)}; it is left out, for together '
            'they would make a wrong map',
            f'set {place.key}.T_base_sensor: [x, y, z, qx, qy, qz, qw]',
        )
        for place in places
        if place.sensor in out
    ]


def identity_extrinsics(places: Sequence[SensorPlace]) -> list[Finding]:
    """Sensors that nobody ties to the car's frame, where there is more than one sensor.

    Whoever gives the pose of one sensor, and none of the IMU, has the IMU for the car's frame.
    """
    placed = any(place.given is not None for place in places)
    untied = [
        place
        for place in places
        if place.known is None and place.frame and (place.lidar or not placed)
    ]
    if not untied or len(places) < 2:
        return []
    frames = ', '.join(f'{place.sensor} (frame {shown_frame(place.frame)})' for place in untied)
    return [
        Finding(
            'identity_extrinsics',
            Severity.WARNING,
            '',
            f'neither the settings nor /tf_static tell where in {BASE_FRAME} these are: {frames}; '
            'each is taken to be there, and turned as the car is',
            _pose_lines(untied),
        )
    ]


def extrinsics_differ(places: Sequence[SensorPlace]) -> list[Finding]:
    """Sensors that the settings and the transforms put to different places."""
    found = []
    for place in places:
        if place.given is None or place.static is None:
            continue
        metres, degrees = _apart(place.given, place.static)
        if metres <= _AGREE_M and degrees <= _AGREE_DEG:
            continue
        text = (
            f'{place.key}.T_base_sensor and /tf_static ({place.frame}) differ by {metres:.2f} m '
            f'and {degrees:.1f} degrees'
        )
        remedy = 'the settings are used; take them out to use /tf_static'
        found.append(Finding('extrinsics_differ', Severity.WARNING, place.sensor, text, remedy))
    return found


def equal_extrinsics(places: Sequence[SensorPlace]) -> list[Finding]:
    """LiDARs at one place; that clouds are in the car's own frame is for whoever put them there."""
    lidars = [place for place in places if place.lidar and place.frame != BASE_FRAME]
    poses = [(place, place.known) for place in lidars]
    equal = [
        place
        for place, pose in poses
        if pose is not None
        and any(
            other is not place and at is not None and np.abs(pose - at).max() <= _SAME
            for other, at in poses
        )
    ]
    if not equal:
        return []
    names = ', '.join(place.sensor for place in equal)
    return [
        Finding(
            'equal_extrinsics',
            Severity.WARNING,
            '',
            f'LiDARs {names} have the same T_base_sensor, as no two have; the map is wrong if they '
            'are apart',
            _pose_lines(equal),
        )
    ]


def bad_transform(topic: str, child: str, parent: str, reason: str) -> Finding:
    """A transform that is none."""
    return Finding(
        'bad_transform',
        Severity.WARNING,
        child,
        f'the transform to {parent} on {topic} is left out: {reason}',
        'correct its publisher',
    )


def told_twice(topic: str, child: str, parent: str, before: Vector, now: Vector) -> list[Finding]:
    """A static transform that is told again, and is another one then.

    Args:
        topic: Where it came from.
        child: The frame that is placed.
        parent: The frame in which it is.
        before: T_parent_child (4, 4) as it was told first.
        now: As it was told last.
    """
    metres, degrees = _apart(before, now)
    if metres <= _AGREE_M and degrees <= _AGREE_DEG:
        return []
    return [
        Finding(
            'transform_changes',
            Severity.WARNING,
            child,
            f'{topic} tells twice where it is in {parent}, {metres:.2f} m and {degrees:.1f} '
            'degrees apart; the last word counts',
            'see which programs publish it, and stop the one that is wrong; T_base_sensor in the '
            'settings counts before both',
        )
    ]


def frame_renamed(sensor: str, before: str, now: str) -> Finding:
    """A sensor's messages have another frame_id than those by which it was placed.

    Args:
        sensor: Its name.
        before: The frame_id that a transform places.
        now: The one that none does.
    """
    return Finding(
        'frame_renamed',
        Severity.WARNING,
        sensor,
        f'its messages are of {shown_frame(now)} by now, which no transform places; it is taken to '
        f'be where {shown_frame(before)} is, as before',
        'see whether another device has taken its place; give the driver the frame_id of before, '
        'or set T_base_sensor',
    )


def other_root(root: str, sensors: Sequence[str]) -> Finding:
    """No transform knows the car's frame, but all hang on one frame.

    Args:
        root: That frame.
        sensors: Who is placed by it.
    """
    return Finding(
        'other_base_frame',
        Severity.MENDED,
        '',
        f'no transform has {BASE_FRAME}; the frame that all of them begin at, {root!r}, is taken '
        f'for it: {", ".join(sensors)} are placed by that',
        f"the map is of {root!r}; where that is not the car's frame set T_base_sensor",
    )


def _apart(one: Vector, other: Vector) -> tuple[float, float]:
    """Metres and degrees between two poses (4, 4)."""
    metres = float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
    turn = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3])
    return metres, float(np.degrees(turn.magnitude()))


def _pose_lines(places: Sequence[SensorPlace]) -> str:
    """What to write where some sensors' poses are to be told."""
    keys = ' and '.join(f'{place.key}.T_base_sensor' for place in places)
    return f'set {keys}: [x, y, z, qx, qy, qz, qw]'
