"""A trajectory of stamped poses: interpolation and the TUM text format."""

from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS

_NANOSECOND = Decimal('1e-9')
_TOO_LATE = Decimal(10_000_000_000)
_STAMPS = np.iinfo(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses T_map_base over time.

    ``stamps`` is (M,) int64 nanoseconds, strictly increasing; ``positions`` is (M, 3) metres;
    ``quaternions`` is (M, 4) x, y, z, w.
    """

    stamps: NDArray[np.int64]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps)

    def rotations(self) -> Rotation:
        """Orientation of base_link in the map at every stamp."""
        return Rotation.from_quat(self.quaternions)

    def matrices(self) -> NDArray[np.float64]:
        """Poses T_map_base as (M, 4, 4) homogeneous matrices."""
        matrices = np.tile(np.eye(4), (len(self), 1, 1))
        matrices[:, :3, :3] = self.rotations().as_matrix()
        matrices[:, :3, 3] = self.positions
        return matrices

    def interpolate(self, stamps: NDArray[np.int64]) -> 'Trajectory':
        """Find the poses at other stamps: linear in position, SLERP in rotation.

        Args:
            stamps: (K,) nanoseconds, in any order.

        Returns:
            K poses at these stamps, in their order.

        Raises:
            ValueError: a stamp lies outside the trajectory; see ``covers``.
        """
        if len(stamps) == 0:
            return Trajectory(stamps, np.zeros((0, 3)), np.zeros((0, 4)))
        if not self.covers(stamps).all():
            raise ValueError('stamps outside the trajectory cannot be interpolated')
        # Seconds since the first pose keep nanosecond stamps exact enough for doubles.
        own = (self.stamps - self.stamps[0]) / NANOSECONDS
        wanted = (stamps - self.stamps[0]) / NANOSECONDS
        if len(self) == 1:
            repeat = np.zeros(len(stamps), dtype=np.int64)
            return Trajectory(stamps, self.positions[repeat], self.quaternions[repeat])
        positions = np.stack(
            [np.interp(wanted, own, self.positions[:, axis]) for axis in range(3)], axis=1
        )
        quaternions = Slerp(own, self.rotations())(wanted).as_quat()
        return Trajectory(stamps, positions, quaternions)

    def covers(self, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which stamps lie between the first and the last pose.

        Args:
            stamps: Stamps (K,), ns.

        Returns:
            True where a stamp lies between them or on one of them, (K,).
        """
        if len(self) == 0:
            return np.zeros(len(stamps), dtype=np.bool_)
        inside: NDArray[np.bool_] = (stamps >= self.stamps[0]) & (stamps <= self.stamps[-1])
        return inside


def from_matrices(stamps: NDArray[np.int64], matrices: NDArray[np.float64]) -> Trajectory:
    """Make a trajectory of matrices.

    Args:
        stamps: (M,) nanoseconds, in any order.
        matrices: T_map_base (M, 4, 4), or their upper rows (M, 3, 4).

    Returns:
        The poses sorted by stamp; of several with one stamp the first counts.
    """
    order = np.unique(stamps, return_index=True)[1]
    return Trajectory(
        stamps=np.asarray(stamps, dtype=np.int64)[order],
        positions=matrices[order, :3, 3],
        quaternions=Rotation.from_matrix(matrices[order, :3, :3]).as_quat().reshape(-1, 4),
    )


def match_truth(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Bring an estimate and the truth to the same stamps.

    Args:
        estimate: poses at stamps of their own.
        truth: the true poses, on the same clock; their map frame may be another one.

    Returns:
        The poses of ``estimate`` within the truth's time span, and the true poses at their stamps.
    """
    inside = truth.covers(estimate.stamps)
    covered = Trajectory(
        estimate.stamps[inside], estimate.positions[inside], estimate.quaternions[inside]
    )
    return covered, truth.interpolate(covered.stamps)


def fit_rigid(points: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit points to others by a rigid transform, without scale (Umeyama).

    By hand, as ``gtsam.Pose3.Align`` gives the same but nothing for fewer than three points.

    Args:
        points: (N, 3) with N >= 1, metres.
        targets: (N, 3), the place of each of them in another frame, metres.

    Returns:
        T_targets_points (4, 4) with the least sum of squared distances. Where the points leave the
        rotation open (they coincide or lie on a line), it is one of the best.
    """
    from_centre = points - points.mean(axis=0)
    to_centre = targets - targets.mean(axis=0)
    left, _, right = np.linalg.svd(to_centre.T @ from_centre)
    mirror = np.sign(np.linalg.det(left) * np.linalg.det(right))
    transform = np.eye(4)
    transform[:3, :3] = left @ np.diag([1.0, 1.0, mirror]) @ right
    transform[:3, 3] = targets.mean(axis=0) - transform[:3, :3] @ points.mean(axis=0)
    return transform


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as TUM text.

    Args:
        path: the file to write; what it held is lost.
        trajectory: poses, a line ``stamp x y z qx qy qz qw`` each. The stamp is in seconds and
            keeps all nine decimals; metres and quaternions have nine decimals too.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open('w', encoding='ascii') as file:
        for stamp, position, turn in zip(
            trajectory.stamps.tolist(), trajectory.positions, trajectory.quaternions, strict=True
        ):
            numbers = ' '.join(f'{value:.9f}' for value in (*position, *turn))
            seconds, fraction = divmod(abs(stamp), NANOSECONDS)
            file.write(f'{"-" * (stamp < 0)}{seconds}.{fraction:09d} {numbers}\n')


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory from TUM text.

    Args:
        path: a file of lines ``stamp x y z qx qy qz qw``; stamps are in seconds, in the notations
            that ``stamp_of_seconds`` knows. Empty lines and lines that begin with # are skipped;
            of several lines with one stamp the first counts.

    Returns:
        The poses sorted by stamp, with quaternions of length 1.

    Raises:
        InputError: the file cannot be read or holds no pose, or a line is none; it is named.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f'{path}: cannot be read as a TUM trajectory ({error})') from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith('#'):
            continue
        reason = ''
        try:
            row = [float(word) for word in words[1:]]
            stamps.append(stamp_of_seconds(words[0]))
        except ValueError as error:
            row, reason = [], f' ({error})'
        if len(row) != 7 or not np.isfinite(row).all() or not np.any(row[3:]):
            raise InputError(
                f'{path}: line {number} is {line.strip()!r}{reason}; '
                'expected "stamp x y z qx qy qz qw"'
            )
        rows.append(row)
    if not rows:
        raise InputError(f'{path}: holds no pose; expected lines "stamp x y z qx qy qz qw"')
    table = np.array(rows)
    order = np.unique(np.array(stamps, dtype=np.int64), return_index=True)[1]
    return Trajectory(
        stamps=np.array(stamps, dtype=np.int64)[order],
        positions=table[order, :3],
        quaternions=Rotation.from_quat(table[order, 3:]).as_quat().reshape(-1, 4),
    )


def stamp_of_seconds(text: str) -> int:
    """The stamp in nanoseconds that a number of seconds stands for.

    Args:
        text: a decimal number such as ``1544581130.999974966``, ``1.544581130999974966e+09`` or
            ``-0.25``. Doubles would lose its last digits, so it is never one.

    Returns:
        The nearest nanosecond, exact for up to nine decimals.

    Raises:
        ValueError: the text is no finite number, or 64 bits cannot hold the stamp.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation as error:
        raise ValueError(f'{text!r} is no number') from error
    # Compared before it is rounded: a large exponent would make a very long integer.
    if seconds.is_finite() and seconds.copy_abs() < _TOO_LATE:
        stamp = int(seconds.quantize(_NANOSECOND).scaleb(9))
        if _STAMPS.min <= stamp <= _STAMPS.max:
            return stamp
    raise ValueError(f'{text!r} is no stamp in seconds')
