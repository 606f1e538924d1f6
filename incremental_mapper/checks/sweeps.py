"""Consecutive clouds of one topic: whole sweeps of one LiDAR, parts of sweeps, or two LiDARs."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.frame_names import shown_frame
from incremental_mapper.measurements import Points

FEWEST_CLOUDS = 12
"""Clouds that tell what a LiDAR sends."""
_BINS = 72
_PARTIAL = 0.6
"""Share of the turn that all clouds together cover, below which single ones are partial. In whole
sweeps of KITTI, MulRan and the simulated drives it was 0.78 or more, in halves it is 0.5."""
_OVERLAP = 0.5
"""Share of a cloud's directions that one of the next three clouds of a turning LiDAR has too, at
most, where each is a part of the sweep. A LiDAR that looks one way covers the same each time."""
_DENSE = 3.0
"""Points for each of the directions that a cloud covers; with fewer nothing can be told."""
_ALTERNATE = 0.35
"""How far a cloud is from the one before the last, by how far it is from the last, at most where
two LiDARs take turns. In all stretches of 12 to 24 clouds (560 of one LiDAR: KITTI, MulRan,
simulated drives that stand, turn, speed up) it was 0.64 or more, mostly 0.9 to 1.8; of two LiDARs
with a VLP-16's tilt between them 0.12 to 0.30."""
_TURNS = 0.75
"""Share of the clouds that are less than half as far from the one before the last as from both
around, at least, so that a lost cloud matters little. Where most clouds are broken it was 0.4 to
0.8 wherever the medians alone took them for two LiDARs (8 of 100 stretches)."""
_APART = 0.3
"""Metres by which mean and spread of two LiDARs' clouds differ at least; it was 4 to 6 m."""
_SAME_PATTERN = 0.5
"""Share of the directions that neighbouring clouds have in common, at least, where both are of
turning heads: two VLP-16 have 0.74 and more. A solid-state LiDAR whose loops drift by half of
their distance from cloud to cloud has 0.06 to 0.25: it is its pattern that takes turns."""
_SAME_PLACE = 0.8
"""How many of the common directions have the same range as in the last cloud, by how many as in
the one before it, at least, where one LiDAR looks at one place: that one has 0.91 and more, two
VLP-16 between houses 0.6."""
_SLIVER = 0.05
"""Share of the points of one kind of clouds with which the other kind is what a driver lost the
rest of: 16 beams beside 128 have an eighth."""
_CELL = np.radians(0.5)
_NEAR, _NEAR_SHARE = 0.3, 0.1
"""Ranges in one direction agree within so many metres, and such a share of them."""


def partial_sweeps(clouds: Sequence[Points]) -> float | None:
    """Tell whether each cloud is another part of the sweep.

    Args:
        clouds: Consecutive clouds of one topic and frame, (N, 3) finite points each.

    Returns:
        The share of the directions that are in one cloud, or None where clouds are whole sweeps,
        or too few to tell.
    """
    if len(clouds) < FEWEST_CLOUDS or np.median([len(cloud) for cloud in clouds]) < 1:
        return None
    covered = np.array([_directions(cloud) for cloud in clouds])
    sizes = covered.sum(axis=1)
    points = np.array([len(cloud) for cloud in clouds])
    share = float(np.median(sizes) / max(covered.any(axis=0).sum(), 1))
    # Neighbours of narrow sectors share a direction, those beside them do not; of halves every
    # other one is the same.
    overlap = min(
        float(np.median((covered[:-lag] & covered[lag:]).sum(axis=1) / np.maximum(sizes[:-lag], 1)))
        for lag in (1, 2, 3)
    )
    dense = bool((points >= _DENSE * sizes).mean() > 0.5)
    return share if share < _PARTIAL and overlap < _OVERLAP and dense else None


def take_turns(clouds: Sequence[Points]) -> bool:
    """Tell whether clouds are like the one before the last, and unlike the last.

    Args:
        clouds: See ``partial_sweeps``.
    """
    sizes = [len(cloud) for cloud in clouds]
    if len(clouds) < FEWEST_CLOUDS or min(sizes) < 2:
        return False
    fewer, more = sorted((float(np.median(sizes[::2])), float(np.median(sizes[1::2]))))
    if fewer < _SLIVER * more:
        return False
    kinds = np.array([[*cloud.mean(axis=0), *cloud.std(axis=0)] for cloud in clouds])
    next_to = np.abs(kinds[1:] - kinds[:-1]).sum(axis=1)
    but_one = np.abs(kinds[2:] - kinds[:-2]).sum(axis=1)
    last, before = float(np.median(next_to)), float(np.median(but_one))
    turns = float((but_one < 0.5 * np.minimum(next_to[:-1], next_to[1:])).mean())
    if not (last > _APART and before < _ALTERNATE * last and turns > _TURNS):
        return False
    return not _one_place_in_turns([_view(cloud) for cloud in clouds])


_View = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Directions in which a cloud has points, ascending, and the nearest range in each, metres."""


def _one_place_in_turns(views: Sequence[_View]) -> bool:
    """Whether clouds that take turns look into other directions and see the same place there."""
    shared, last = np.median([_common(a, b) for a, b in pairwise(views)], axis=0)
    _, before = np.median([_common(a, b) for a, b in zip(views, views[2:], strict=False)], axis=0)
    return bool(shared < _SAME_PATTERN and last > _SAME_PLACE * before)


def _view(cloud: Points) -> _View:
    """What a cloud sees in which direction."""
    ranges = np.linalg.norm(cloud, axis=1).astype(np.float64)
    azimuth = np.arctan2(cloud[:, 1], cloud[:, 0])
    elevation = np.arctan2(cloud[:, 2], np.hypot(cloud[:, 0], cloud[:, 1]))
    columns = np.floor(azimuth / _CELL).astype(np.int64)
    cells = columns * 1000 + np.floor(elevation / _CELL).astype(np.int64)
    order = np.argsort(cells, kind='stable')
    directions, starts = np.unique(cells[order], return_index=True)
    return directions, np.minimum.reduceat(ranges[order], starts)


def _common(one: _View, other: _View) -> tuple[float, float]:
    """Share of the directions that two clouds have in common, and of those with one range."""
    directions, first, second = np.intersect1d(
        one[0], other[0], assume_unique=True, return_indices=True
    )
    a, b = one[1][first], other[1][second]
    near = np.abs(a - b) < _NEAR + _NEAR_SHARE * np.minimum(a, b)
    share = len(directions) / min(len(one[0]), len(other[0]))
    return share, float(near.mean()) if len(directions) else 0.0


def sector_clouds(lidar: str, topic: str, share: float) -> Finding:
    """Clouds are parts of a sweep: see ``partial_sweeps``.

    Args:
        lidar: Whose they are.
        topic: Where they come.
        share: What ``partial_sweeps`` returned.
    """
    return Finding(
        'sector_clouds',
        Severity.MENDED,
        lidar,
        f'sends partial sweeps: a cloud of {topic} covers {100 * share:.0f} % of the directions '
        'that its clouds cover together',
        f'gathered into whole sweeps (lidars.{lidar}.sectors: true)',
        {'lidars': {lidar: {'sectors': True}}},
    )


def two_lidars_one_frame(lidar: str, topic: str, frame: str) -> Finding:
    """Two kinds of clouds take turns under one frame_id: see ``take_turns``."""
    return Finding(
        'two_lidars_one_frame',
        Severity.ERROR,
        lidar,
        f'two kinds of clouds take turns on {topic} under the one frame_id {shown_frame(frame)}, '
        'as of two LiDARs; they cannot be told apart, and the map is of both as if they were one',
        'give each its own topic or frame_id in its driver, and record again',
    )


def several_frames(topic: str, counts: Mapping[str, int]) -> Finding:
    """Clouds of one topic have several frame_ids, each of a LiDAR of its own.

    Args:
        topic: Where they come.
        counts: Number of clouds by frame_id.
    """
    listed = ', '.join(f'{shown_frame(frame)} {count}x' for frame, count in counts.items())
    return Finding(
        'several_frames',
        Severity.MENDED,
        topic,
        f'clouds of {len(counts)} frames come on one topic ({listed})',
        'each frame_id is taken for a LiDAR of its own; give each a topic',
    )


def other_frame(lidar: str, expected: str, frame: str, count: int, owner: str) -> Finding:
    """Clouds whose frame_id is not the one that the first had.

    Args:
        lidar: On whose topic they came.
        expected: The frame_id of the first ones there.
        frame: Theirs.
        count: How many they are.
        owner: The LiDAR whose first clouds had that frame_id; '' where there is none.
    """
    what = (
        f'two LiDARs that exchanged their topics; they are taken for those of {owner}'
        if owner
        else 'two LiDARs on one topic, or a frame that was renamed; they are used as if nothing '
        'had changed'
    )
    return Finding(
        'other_frame',
        Severity.WARNING,
        lidar,
        f'{count} clouds have the frame_id {shown_frame(frame)} where others have '
        f'{shown_frame(expected)}: {what}',
        'give each LiDAR its own topic, and record again',
    )


def _directions(cloud: Points) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which of the directions around the LiDAR have points."""
    azimuth = np.arctan2(cloud[:, 1], cloud[:, 0])
    index = ((azimuth / (2.0 * np.pi) + 0.5) * _BINS).astype(int) % _BINS
    return np.bincount(index, minlength=_BINS) > 0
