"""Whether the matches of drives with truth are as uncertain as they say.

    python benchmarks/match_noise.py DRIVE... [--config config/kaist.yaml] [--set KEY=VALUE]
        [--spans 1 10 40] [--out match_noise.png]

Printed is the mean squared error of a motion over its variance, by axis (roll, pitch, yaw, x, y, z
of base_link) and over all of them, which is 1 where the covariance is right: of single matches, and
of so many matches of one LiDAR added up. Errors of consecutive matches are much alike, so that sums
are further off than independent matches would be: ``odometry.covariance_scale`` is chosen for a
second, ten matches, after which fixes and the IMU know better. The picture has the histogram of
the normalised errors of every axis beside the normal distribution.
"""

import argparse
import itertools
from collections import deque
from pathlib import Path
from typing import Any

import gtsam
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from odometry import changed
from scipy.stats import norm

from incremental_mapper.datasets.open import open_source
from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.frontend.match_noise import carried
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.factors import pose_sigmas
from incremental_mapper.measurements import NANOSECONDS, ImuSample, LidarScan
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import make_config, merge, read_yaml
from incremental_mapper.trajectory import Trajectory

AXES = ('roll', 'pitch', 'yaw', 'x', 'y', 'z')
SLACK = 0.5
"""Seconds after a scan by which the IMU has passed the end of its sweep."""


def matched(drive: Path, tree: dict[str, Any]) -> tuple[list[PreparedScan], Trajectory]:
    """The scans of a drive with their odometry, and the truth."""
    source = open_source(drive, tree)
    truth = source.truth()
    if truth is None:
        raise SystemExit(f'{drive}: has no truth')
    has_imu = any(isinstance(item, ImuSample) for item in source.measurements())
    end = FrontEnd(effective_config(source, tree, str(drive)), imu_expected=has_imu)
    waiting: deque[LidarScan] = deque()
    found: list[PreparedScan] = []

    def prepare(until: float) -> None:
        while waiting and waiting[0].stamp <= until:
            prepared = end.prepare((waiting.popleft(),))
            found.extend(item for item in prepared if isinstance(item, PreparedScan))

    for measurement in source.measurements():
        if isinstance(measurement, ImuSample):
            end.imu(measurement)
        elif isinstance(measurement, LidarScan):
            end.begin(measurement)
            waiting.append(measurement)
        prepare(measurement.stamp - SLACK * NANOSECONDS)
    prepare(np.inf)
    end.close()
    return found, truth


def normalised(
    scans: list[PreparedScan], truth: Trajectory, constant: NDArray[np.float64], span: int
) -> list[NDArray[np.float64]]:
    """Errors of ``span`` matches added up: each axis by its deviation (6,), and the square of all.

    ``constant`` (6, 6) is the covariance of a match that has none.
    """
    found = []
    for start in range(0, len(scans) - span + 1, max(span // 2, 1)):
        part = scans[start : start + span]
        # A chain of matches, each of which begins where the one before it ended.
        chain = all(item.previous == before.core.stamp for before, item in itertools.pairwise(part))
        stamps = np.array([part[0].previous or 0, part[-1].core.stamp])
        if part[0].previous is None or not chain or not truth.covers(stamps).all():
            continue
        motion, covariance = gtsam.Pose3(), np.zeros((6, 6))
        for item in part:
            assert item.T_previous_current is not None
            motion = motion.compose(item.T_previous_current)
            own = constant if item.covariance is None else item.covariance
            covariance = carried(covariance, item.T_previous_current.inverse()) + own
        before, after = (gtsam.Pose3(pose) for pose in truth.interpolate(stamps).matrices())
        error = gtsam.Pose3.Logmap(before.between(after).between(motion))
        whole = error @ np.linalg.solve(covariance, error) / 6.0
        found.append(np.append(error / np.sqrt(np.diag(covariance)), np.sqrt(whole)))
    return found


def draw(errors: NDArray[np.float64], path: Path, title: str) -> None:
    """Histograms of the normalised errors (N, 6) beside the normal distribution."""
    figure, parts = plt.subplots(2, 3, figsize=(10, 6), sharex=True, sharey=True)
    bins = np.linspace(-4.0, 4.0, 41)
    for axis, part, values in zip(AXES, parts.ravel(), errors.T, strict=True):
        part.hist(np.clip(values, -4.0, 4.0), bins=bins, density=True, color='0.7')
        part.plot(bins, norm.pdf(bins), color='C3')
        part.set_title(f'{axis}: {np.mean(values**2):.2f}')
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main() -> None:
    """Print and draw the normalised errors of every set of settings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drives', nargs='+', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE,...')
    parser.add_argument('--spans', nargs='+', type=int, default=[1, 10, 40])
    parser.add_argument('--out', type=Path, help='picture of the first set of settings')
    args = parser.parse_args()
    tree = {} if args.config is None else read_yaml(args.config)
    for text in ['', *args.set]:
        own = merge(changed(tree, text), {'odometry': {'processes': False}})
        print(f'\n{text or "settings as they are"}')
        print(f'span  {"drive":24}', *(f'{name:>6}' for name in (*AXES, 'all')))
        sums: dict[int, list[NDArray[np.float64]]] = {span: [] for span in args.spans}
        for drive in args.drives:
            scans, truth = matched(drive, own)
            for span in args.spans:
                rows = []
                for name in sorted({item.core.sensor for item in scans}):
                    chain = [item for item in scans if item.core.sensor == name]
                    constant = constant_of(own)
                    rows += normalised(chain, truth, constant, span)
                show(span, drive.name, np.array(rows))
                sums[span] += rows
        for span, rows in sums.items():
            show(span, 'all', np.array(rows))
        if args.out is not None and not text:
            span = max(span for span in args.spans if span <= 10)
            title = f'errors of {span} matches by their standard deviations; mean squares'
            draw(np.array(sums[span])[:, :6], args.out, title)


def constant_of(tree: dict[str, Any]) -> NDArray[np.float64]:
    """Covariance (6, 6) of a match that has none of its own."""
    odometry = make_config(tree).odometry
    return np.diag(pose_sigmas(odometry.sigma_translation, odometry.sigma_rotation) ** 2)


def show(span: int, name: str, rows: NDArray[np.float64]) -> None:
    """A line of the table."""
    if len(rows):
        print(f'{span:4}  {name:24}', *(f'{value:6.2f}' for value in np.mean(rows**2, axis=0)))


if __name__ == '__main__':
    main()
