"""Whether the covariances of the poses that the node publishes are what their errors are.

    python benchmarks/published_covariance.py DRIVE... [--config config/kaist.yaml]
        [--set KEY=VALUE,...] [--outage FROM TO] [--strategy mom]

Every window's newest pose is held against the truth; with ``--outage`` the drive's fixes between
two times, in seconds from its start, are left out. The map's place among the truth is that of the
poses before the outage, or of all of them, each of which counts by its own variance: one that was
0.3 m off in a gap of the fixes, and said so, moves none that were known to 0.02 m. Printed is the
mean of the squared error over its variance by axis of base_link, which is 1 where the covariance is
right, over all windows and, in an outage, over those in it; and the largest errors beside their
deviations.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from odometry import changed

from incremental_mapper.datasets.open import open_source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.measurements import NANOSECONDS, GnssFix, Measurement
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory, from_matrices, match_truth

AXES = ('roll', 'pitch', 'yaw', 'x', 'y', 'z')


def without(
    measurements: Iterator[Measurement], outage: tuple[float, float] | None
) -> Iterator[Measurement]:
    """Measurements without the fixes of an outage."""
    start = None
    for item in measurements:
        start = item.stamp if start is None else start
        seconds = (item.stamp - start) / NANOSECONDS
        if outage and isinstance(item, GnssFix) and outage[0] < seconds < outage[1]:
            continue
        yield item


def published(
    drive: Path, tree: dict[str, Any], outage: tuple[float, float] | None
) -> tuple[list[NewestState], Trajectory]:
    """The newest state of every window, and the truth."""
    source = open_source(drive, tree)
    truth = source.truth()
    if truth is None:
        raise SystemExit(f'{drive}: has no truth')
    mapper = Mapper(effective_config(source, tree, str(drive)))
    states: list[NewestState] = []

    def keep() -> None:
        newest = mapper.newest()
        # Before the map is turned to north, poses stand in another frame.
        if newest is not None and newest.covariance is not None and mapper.state.georeferenced:
            states.append(newest)

    for measurement in without(source.measurements(), outage):
        if mapper.push(measurement):
            keep()
    mapper.flush()
    keep()
    mapper.close()
    return states, truth


def normalised(
    states: list[NewestState], truth: Trajectory, until: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Errors (N, 6), their deviations (N, 6), squares by the covariance (N, 2), stamps (N,).

    The squares are those of rotation and of position. ``until`` is the last stamp that tells where
    the map is.
    """
    poses = np.array([state.pose.matrix() for state in states])
    stamps = np.array([state.stamp for state in states], dtype=np.int64)
    matched = match_truth(from_matrices(stamps, poses), truth)
    estimate, real = matched
    first = estimate.stamps <= until
    by_stamp = {state.stamp: state for state in states}
    variances = np.array([variance(by_stamp[int(stamp)]) for stamp in estimate.stamps])
    T_truth_map = fit(estimate.positions[first], real.positions[first], 1.0 / variances[first])
    errors, deviations, squares = [], [], []
    for stamp, pose, goal in zip(
        estimate.stamps, estimate.matrices(), real.matrices(), strict=True
    ):
        state = by_stamp[int(stamp)]
        error = gtsam.Pose3.Logmap(gtsam.Pose3(T_truth_map @ pose).between(gtsam.Pose3(goal)))
        covariance = state.covariance
        assert covariance is not None
        errors.append(error)
        deviations.append(np.sqrt(np.diag(covariance)))
        squares.append(
            [
                error[part] @ np.linalg.solve(covariance[part, part], error[part]) / 3.0
                for part in (slice(0, 3), slice(3, 6))
            ]
        )
    return np.array(errors), np.array(deviations), np.array(squares), estimate.stamps


def variance(state: NewestState) -> float:
    """Of the position, by axis on the average, m^2."""
    assert state.covariance is not None
    return float(np.trace(state.covariance[3:, 3:])) / 3.0


def fit(
    estimate: NDArray[np.float64], real: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """T_truth_map (4, 4) by positions (N, 3) of weights (N,); both have their z axis upwards."""
    estimate_mean, real_mean = (
        np.average(each, axis=0, weights=weights) for each in (estimate, real)
    )
    # Level positions as complex numbers: a turn is a factor.
    a, b = (each[:, 0] + 1j * each[:, 1] for each in (estimate - estimate_mean, real - real_mean))
    turn = gtsam.Rot3.Yaw(float(np.angle(np.sum(weights * np.conj(a) * b))))
    return gtsam.Pose3(turn, real_mean - turn.rotate(estimate_mean)).matrix()


def main() -> None:
    """Map every drive and print how well its covariances tell its errors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drives', nargs='+', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--set', default='', metavar='KEY=VALUE,...')
    parser.add_argument('--outage', nargs=2, type=float, metavar=('FROM', 'TO'))
    parser.add_argument('--strategy', default='mom')
    args = parser.parse_args()
    tree = {} if args.config is None else read_yaml(args.config)
    tree = merge(changed(tree, args.set), {'selection': {'strategy': args.strategy}})
    outage = None if args.outage is None else (args.outage[0], args.outage[1])
    print(f'{"drive":24} {"poses":>6} {"rotation":>9} {"position":>9}   by axis')
    for drive in args.drives:
        states, truth = published(drive, tree, outage)
        start = states[0].stamp
        begin, end = (start + round(s * NANOSECONDS) for s in outage or (0.0, 0.0))
        until = begin if outage else states[-1].stamp
        errors, deviations, squares, stamps = normalised(states, truth, until)
        parts = {'all': stamps > 0}
        if outage:
            parts = {'with fixes': stamps <= begin, 'outage': (stamps > begin) & (stamps < end)}
        for name, part in parts.items():
            rotation, position = squares[part].mean(axis=0)
            ratios = (errors[part] ** 2 / deviations[part] ** 2).mean(axis=0)
            axes = ' '.join(f'{a} {r:.2f}' for a, r in zip(AXES, ratios, strict=True))
            title = f'{drive.name} {name}'
            print(f'{title:24} {part.sum():6} {rotation:9.2f} {position:9.2f}   {axes}')
            worst = int(np.argmax(np.abs(errors[part][:, 3])))
            print(
                f'{"":24} along the track at most {abs(errors[part][worst, 3]):.2f} m off where '
                f'the deviation is {deviations[part][worst, 3]:.2f} m',
                flush=True,
            )


if __name__ == '__main__':
    main()
