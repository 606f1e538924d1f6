"""Where the sensors of a bag sit on the car: by the settings, else by its static transforms."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from incremental_mapper.config import Tree
from incremental_mapper.datasets.static_transforms import (
    BASE_FRAME,
    MOVING_TOPIC,
    STATIC_TOPIC,
    FrameTree,
    add_still_transforms,
    clean,
    read_static_transforms,
)
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.settings import merge

_AGREE_M, _AGREE_DEG = 0.1, 2.0
"""Metres and degrees by which settings and the bag's transforms may differ unsaid; two careful
calibrations of one car do."""


def find_extrinsics(
    reader: AnyReader,
    settings: Mapping[str, Any],
    frames: Mapping[str, str],
    lidars: tuple[str, ...],
) -> tuple[Tree, list[str]]:
    """Find T_base_sensor of every sensor that the settings say nothing of.

    Args:
        reader: an open bag.
        settings: all settings that there are, as nested dictionaries.
        frames: the frame_id of each sensor's messages.
        lidars: which of the sensors are LiDARs.

    Returns:
        A settings tree with T_base_sensor (x, y, z, qx, qy, qz, qw) of those that the transforms
        tell of, and notes on where each is from.
    """
    tree = read_static_transforms(reader)
    given = {name: _given(settings, name, lidars) for name in frames}
    unknown = [name for name, pose in given.items() if pose is None]
    of_static = set(tree.edges)
    if any(_pose(tree, frames[name]) is None for name in unknown):
        add_still_transforms(reader, tree)
    notes = list(tree.notes)
    found: Tree = {}
    from_settings: list[str] = []
    untied: list[str] = []
    for name, frame in frames.items():
        key = f'lidars.{name}' if name in lidars else name
        pose = _pose(tree, frame)
        if given[name] is not None:
            from_settings.append(name)
            notes.extend(_difference(key, given[name], pose, frame))
        elif pose is not None and clean(frame) != tree.base():
            own = {'T_base_sensor': pose}
            found = merge(found, {'lidars': {name: own}} if name in lidars else {name: own})
            source = (
                STATIC_TOPIC
                if of_static == set(tree.edges)
                else (f'{STATIC_TOPIC} and {MOVING_TOPIC}' if of_static else MOVING_TOPIC)
            )
            notes.append(
                f'{key}.T_base_sensor: from {source}, {frame} to {tree.base()}: '
                f'[{", ".join(f"{number:.4g}" for number in pose)}]'
            )
        elif frame and clean(frame) not in (BASE_FRAME, tree.base()) and len(frames) > 1:
            untied.append(f'{key}.T_base_sensor (frame {frame!r})')
    if untied:
        notes.append(
            f'{", ".join(untied)}: neither the settings nor {STATIC_TOPIC} tell where that is in '
            f'{BASE_FRAME}; taken for the identity (identity_extrinsics); set each, '
            '[x, y, z, qx, qy, qz, qw]'
        )
    if from_settings:
        notes.append(f'T_base_sensor of {", ".join(from_settings)}: from the settings')
    return found, [*notes, *_equal(settings, found, lidars)]


def _given(settings: Mapping[str, Any], name: str, lidars: tuple[str, ...]) -> Any:
    """T_base_sensor as the settings have it, or None."""
    owner = settings.get('lidars', {}) if name in lidars else settings
    section = owner.get(name, {}) if isinstance(owner, Mapping) else {}
    return section.get('T_base_sensor') if isinstance(section, Mapping) else None


def _pose(tree: FrameTree, frame: str) -> list[float] | None:
    """x, y, z, qx, qy, qz, qw of a frame in the car's."""
    base = tree.base()
    matrix = None if base is None or not frame else tree.between(base, frame)
    if matrix is None:
        return None
    turn = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return [float(number) for number in (*matrix[:3, 3], *turn)]


def _difference(key: str, given: Any, pose: list[float] | None, frame: str) -> list[str]:
    """A note where the settings and the transforms put a sensor to different places."""
    if pose is None:
        return []
    ours, theirs = pose_matrix(given), pose_matrix(pose)
    metres = float(np.linalg.norm(ours[:3, 3] - theirs[:3, 3]))
    turn = Rotation.from_matrix(ours[:3, :3].T @ theirs[:3, :3])
    degrees = float(np.degrees(turn.magnitude()))
    if metres <= _AGREE_M and degrees <= _AGREE_DEG:
        return []
    return [
        f'{key}.T_base_sensor: the settings and {STATIC_TOPIC} ({frame}) differ by {metres:.2f} m '
        f'and {degrees:.1f} degrees (extrinsics_differ); the settings are used, take them out to '
        'use the other'
    ]


def _equal(settings: Mapping[str, Any], found: Tree, lidars: tuple[str, ...]) -> list[str]:
    """A note where all LiDARs are at one place."""
    both = merge(dict(settings), found)
    identity = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    poses = [list(_given(both, name, lidars) or identity) for name in lidars]
    if len(poses) < 2 or any(pose != poses[0] for pose in poses):
        return []
    return [
        f'LiDARs {", ".join(lidars)} have the same T_base_sensor (equal_extrinsics); '
        'set lidars.NAME.T_base_sensor of each'
    ]
