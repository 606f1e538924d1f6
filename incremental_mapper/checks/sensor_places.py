"""Where the sensors sit on the car, by the settings and by the recording's transforms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Finding, Severity
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
    """

    sensor: str
    key: str
    frame: str
    lidar: bool
    given: Vector | None = None
    static: Vector | None = None

    @property
    def known(self) -> Vector | None:
        """T_base_sensor (4, 4) as far as anybody tells: the settings come first."""
        return self.static if self.given is None else self.given


def identity_extrinsics(places: Sequence[SensorPlace]) -> list[Finding]:
    """Sensors that nobody ties to the car's frame, where there is more than one sensor."""
    untied = [place for place in places if place.known is None and place.frame]
    if not untied or len(places) < 2:
        return []
    frames = ', '.join(f'{place.sensor} (frame {place.frame!r})' for place in untied)
    lines = ' and '.join(f'{place.key}.T_base_sensor' for place in untied)
    return [
        Finding(
            'identity_extrinsics',
            Severity.WARNING,
            '',
            f'neither the settings nor /tf_static tell where in {BASE_FRAME} are {frames}; taken '
            'for the identity',
            f'set {lines}: [x, y, z, qx, qy, qz, qw]',
        )
    ]


def extrinsics_differ(places: Sequence[SensorPlace]) -> list[Finding]:
    """Sensors that the settings and the transforms put to different places."""
    found = []
    for place in places:
        if place.given is None or place.static is None:
            continue
        metres = float(np.linalg.norm(place.given[:3, 3] - place.static[:3, 3]))
        turn = Rotation.from_matrix(place.given[:3, :3].T @ place.static[:3, :3])
        degrees = float(np.degrees(turn.magnitude()))
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
    """LiDARs of different frames that are all at one place."""
    lidars = [place for place in places if place.lidar]
    poses = [np.eye(4) if place.known is None else place.known for place in lidars]
    if len(lidars) < 2 or any(np.abs(pose - poses[0]).max() > _SAME for pose in poses):
        return []
    names = ', '.join(place.sensor for place in lidars)
    lines = ' and '.join(f'{place.key}.T_base_sensor' for place in lidars)
    return [
        Finding(
            'equal_extrinsics',
            Severity.WARNING,
            '',
            f'LiDARs {names} have the same T_base_sensor',
            f'set {lines}: [x, y, z, qx, qy, qz, qw]',
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
