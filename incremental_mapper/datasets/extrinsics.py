"""Where the sensors of a bag sit on the car: by the settings, else by its static transforms."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.sensor_places import (
    BASE_FRAME,
    SensorPlace,
    equal_extrinsics,
    extrinsics_differ,
    identity_extrinsics,
    lidars_left_out,
    other_root,
    unplaced_lidars,
)
from incremental_mapper.config import Tree
from incremental_mapper.datasets.sensor_settings import extrinsics_of
from incremental_mapper.datasets.static_transforms import (
    MOVING_TOPIC,
    STATIC_TOPIC,
    FrameTree,
    add_still_transforms,
    clean,
    read_static_transforms,
)
from incremental_mapper.datasets.topics import MAP_FRAMES
from incremental_mapper.geometry import matrix_numbers, pose_matrix
from incremental_mapper.measurements import Vector
from incremental_mapper.settings import merge


@dataclass(frozen=True, slots=True)
class Extrinsics:
    """Where the sensors are.

    Attributes:
        settings: T_base_sensor (x, y, z, qx, qy, qz, qw) of the sensors that only the recording's
            transforms tell of, as a settings tree.
        notes: where each pose is from.
        findings: what is wrong with them.
        left_out: LiDARs that nobody places beside the others.
    """

    settings: Tree
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]
    left_out: tuple[str, ...] = ()


def find_extrinsics(
    reader: AnyReader,
    settings: Mapping[str, Any],
    frames: Mapping[str, str],
    lidars: Mapping[str, float],
) -> Extrinsics:
    """Find T_base_sensor of every sensor that the settings say nothing of.

    Args:
        reader: an open bag.
        settings: all settings that there are, as nested dictionaries.
        frames: the frame_id of each sensor's messages.
        lidars: which of the sensors are LiDARs, and how many points each has.

    Returns:
        Their poses, as far as they can be told.
    """
    tree = read_static_transforms(reader)
    given = {name: extrinsics_of(settings, name, lidars) for name in frames}
    of_static = set(tree.edges)
    if any(pose is None and _pose(tree, frames[name]) is None for name, pose in given.items()):
        add_still_transforms(reader, tree)
    root = tree.root()
    if tree.base() is None and root is not None and root not in MAP_FRAMES:
        placed = [name for name, pose in given.items() if pose is None]
        placed = [name for name in placed if tree.between(root, frames[name]) is not None]
        if placed:
            tree.wanted = root
            tree.findings.append(other_root(root, placed))
    sources = [STATIC_TOPIC] * bool(of_static) + [MOVING_TOPIC] * (set(tree.edges) != of_static)
    return place_sensors(tree, sources, settings, frames, lidars)


def place_sensors(
    tree: FrameTree,
    sources: Sequence[str],
    settings: Mapping[str, Any],
    frames: Mapping[str, str],
    lidars: Mapping[str, float],
) -> Extrinsics:
    """Say where the sensors are by the settings, else by transforms; as ``find_extrinsics``.

    Args:
        tree: transforms that do not move.
        sources: topics that they are from.
        settings: see there.
        frames: see there.
        lidars: see there.
    """
    given = {name: extrinsics_of(settings, name, lidars) for name in frames}
    places = [
        SensorPlace(
            name,
            f'lidars.{name}' if name in lidars else name,
            clean(frame),
            name in lidars,
            None if given[name] is None else pose_matrix(given[name]),
            _pose(tree, frame),
            lidars.get(name, 0.0),
        )
        for name, frame in frames.items()
    ]
    left_out = unplaced_lidars(places)
    without = lidars_left_out(places)
    places = [place for place in places if place.sensor not in left_out]
    notes: list[str] = []
    found: Tree = {}
    for place in places:
        own_frame = place.frame in (BASE_FRAME, tree.base())
        if place.given is not None or place.static is None or own_frame:
            continue
        pose = matrix_numbers(place.static)
        own = {place.sensor: {'T_base_sensor': pose}}
        found = merge(found, {'lidars': own} if place.lidar else own)
        notes.append(
            f'{place.key}.T_base_sensor: from {" and ".join(sources)}, {place.frame} to '
            f'{tree.base()}: [{", ".join(f"{number:.4g}" for number in pose)}]'
        )
    from_settings = [place.sensor for place in places if place.given is not None]
    if from_settings:
        notes.append(f'T_base_sensor of {", ".join(from_settings)}: from the settings')
    findings = [
        *tree.findings,
        *without,
        *identity_extrinsics(places),
        *extrinsics_differ(places),
        *equal_extrinsics(places),
    ]
    return Extrinsics(found, tuple(notes), tuple(findings), tuple(left_out))


def _pose(tree: FrameTree, frame: str) -> Vector | None:
    """T_base_sensor (4, 4) of a frame; that of the car's own frame is the identity."""
    if clean(frame) in (BASE_FRAME, tree.base()):
        return np.eye(4)
    base = tree.base()
    return None if base is None or not frame else tree.between(base, frame)
