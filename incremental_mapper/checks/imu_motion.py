"""An IMU's rates and accelerations beside the motion that scan matching found: unit, axes, clock.

Scan matching knows nothing of the IMU, so that what both of them see is true. Where the car drives
straight on there is little to compare, and then nothing is said.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import NANOSECONDS

Array = NDArray[np.float64]

STEP = 0.005
"""Seconds between two lags that are tried."""
COARSE = 5
"""Steps between two lags at first; half of what a bump takes."""
MOST_COMPARED = 250
"""Matches that are compared at all lags, those that turn most."""
FEWEST = 16
"""Matches below which nothing is compared."""
MAX_LAG = 2.0
"""Seconds by which the IMU's clock is looked for, before and after."""
LAG_SHARE = 0.2
"""Share of the samples' time by which they may be shifted at most: what is left must suffice."""
MAX_HOLE = 0.25
"""Seconds without a sample over which nothing is integrated."""
LONGEST = 0.6
"""Seconds of a match that is compared; over more than that, rotations do not add up as vectors."""
BLOCK = 1.0
"""Seconds over which accelerations are compared. A match is good to some centimetres, so within
1 s the acceleration is to 0.1 to 0.3 m/s^2 on all drives here, within 0.5 s to 0.2 to 1.4."""
LARGEST = 0.5
"""rad; rotations above it do not add up as vectors either."""
FORCE_SIGMA = 0.6
"""m/s^2; deviation of an acceleration by scan matching and by the IMU: 0.1 to 0.5 on the drives
here, and 0.3 for a road's slope that changes."""
TURN_SIGMA = 0.002
"""rad; the least deviation of a match's rotation: 0.0008 to 0.0026 on the drives here."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionEvidence:
    """Matches of scans, and the IMU's samples of the same time, N and K of them.

    Attributes:
        spans: Stamps of each match's first and second scan (N, 2), ns.
        turns: Rotation vectors of the matches (N, 3) in base_link, rad.
        shifts: Their translations (N, 3) in base_link, m.
        stamps: Of the samples (K,), ns, in time order.
        gyro: Rates (K, 3), scaled and turned into base_link as the settings say, rad/s.
        force: Accelerations (K, 3), the same way, m/s^2.
        gravity: Magnitude of gravity in them, m/s^2; 0 where there is none.
    """

    spans: NDArray[np.int64]
    turns: Array
    shifts: Array
    stamps: NDArray[np.int64]
    gyro: Array
    force: Array
    gravity: float


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How the IMU's rotation and that of scan matching agree at one lag.

    Attributes:
        lag: Seconds to be added to the IMU's stamps.
        count: Matches that were compared.
        aligned: Correlation as the extrinsics put the axes, -1 to 1.
        turned: Correlation with the axes turned as fits best.
        scale: Factor of the rates that fits best, with the axes turned so.
        sigma: Its standard deviation.
        lidar: Root mean square of the matches' rotations, rad.
        imu: The same of the IMU's.
    """

    lag: float
    count: int
    aligned: float
    turned: float
    scale: float
    sigma: float
    lidar: float
    imu: float

    @property
    def likelihood(self) -> float:
        """Logarithm of the likelihood ratio to no agreement at all."""
        return -1.5 * self.count * float(np.log(max(1.0 - self.turned**2, 1e-9)))


class Comparison:
    """Compares the rotation over the same matches, at any lag."""

    def __init__(self, evidence: MotionEvidence) -> None:
        """Integrate the rates once; a match's rotation is the difference of two places in them."""
        start = int(min(evidence.stamps[0], evidence.spans.min()))
        spans = (evidence.spans - start) / NANOSECONDS
        size = np.linalg.norm(evidence.turns, axis=1)
        keep = np.flatnonzero((spans[:, 1] - spans[:, 0] < LONGEST) & (size < LARGEST))
        keep = keep[np.argsort(size[keep])[-MOST_COMPARED:]]
        self._turns = evidence.turns[keep]
        self._low = np.rint(spans[keep, 0] / STEP).astype(int)
        self._high = np.rint(spans[keep, 1] / STEP).astype(int)
        self.half = 0.5 * float(np.median(spans[keep, 1] - spans[keep, 0])) if len(keep) else 0.0
        moments = (evidence.stamps - start) / NANOSECONDS
        first, last = np.ceil(moments[0] / STEP), np.floor(moments[-1] / STEP)
        self._first = int(first)
        columns = integrated(evidence.stamps, evidence.gyro).T
        grid = np.arange(first, last + 1) * STEP
        # One array for each axis: they are looked up by the ten thousand.
        *self._integral, self._holes = (np.interp(grid, moments, column) for column in columns)

    def at(self, lag: float) -> Agreement | None:
        """Compare with ``lag`` seconds added to the IMU's stamps; None where hardly any match."""
        found = self._agreements(np.array([round(lag / STEP)]))
        return found[0] if found else None

    def best(self) -> Agreement | None:
        """The lag of the highest correlation, whichever way the axes stand."""
        most = round(min(MAX_LAG, LAG_SHARE * len(self._holes) * STEP) / STEP)
        found = self._agreements(np.arange(-most, most + 1, COARSE))
        if not found:
            return None
        near = round(max(found, key=lambda one: one.turned).lag / STEP)
        found += self._agreements(np.arange(near - COARSE + 1, near + COARSE))
        return max(found, key=lambda one: one.turned)

    def support(self, lag: float) -> float:
        """How much likelier ``lag`` is than none, by the half of the matches that says it least.

        Both are held against the same matches. A single turn may look like one a second before;
        the other half of the drive knows nothing of that.
        """
        steps = np.array([round(lag / STEP), 0])
        both = np.flatnonzero(self._inside(steps).all(axis=0))
        in_time = both[np.argsort(self._low[both], kind='stable')]
        gains = []
        for members in np.array_split(in_time, 2):
            half = np.zeros(len(self._low), dtype=bool)
            half[members] = True
            found = self._agreements(steps, half)
            if len(found) < 2:
                return 0.0
            gains.append(found[0].likelihood - found[1].likelihood)
        return min(gains)

    def _inside(self, steps: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which matches (L, N) the samples cover at lags of so many ``STEP``."""
        shift = steps[:, None] + self._first
        covered: NDArray[np.bool_] = self._low >= shift
        covered &= self._high - shift < len(self._holes)
        return covered

    def _agreements(
        self, steps: NDArray[np.int64], among: NDArray[np.bool_] | None = None
    ) -> list[Agreement]:
        """Agreement at lags of so many ``STEP``, those with enough matches."""
        shift = steps[:, None] + self._first
        low, high = self._low - shift, self._high - shift
        inside = self._inside(steps)
        if among is not None:
            inside &= among
        if self._holes[-1] > self._holes[0]:
            inside &= _between(self._holes, low, high) <= 0.0
        used = inside.astype(float)
        whole = bool(inside.all())
        products, other = np.zeros((len(steps), 3, 3)), np.zeros(len(steps))
        for axis, integral in enumerate(self._integral):
            turned = _between(integral, low, high)
            if not whole:
                turned *= used
            products[:, :, axis] = turned @ self._turns
            other += np.einsum('ln,ln->l', turned, turned)
        own, counts = used @ (self._turns**2).sum(axis=1), inside.sum(axis=1)
        sizes = np.linalg.svd(products, compute_uv=False)
        sizes[:, 2] *= np.sign(np.linalg.det(products))
        best = sizes.sum(axis=1)
        straight = np.trace(products, axis1=1, axis2=2)
        norm = np.maximum(np.sqrt(own * other), 1e-30)
        scale = best / np.maximum(other, 1e-30)
        rest = np.maximum(own - best * scale, 0.0) / np.maximum(3 * counts, 1)
        sigma = np.sqrt(rest / np.maximum(other, 1e-30))
        wanted = len(self._turns) if among is None else int(among.sum())
        fewest = max(FEWEST // 2 if among is not None else FEWEST, wanted // 2)
        return [
            Agreement(
                lag=int(steps[i]) * STEP,
                count=int(counts[i]),
                aligned=float(straight[i] / norm[i]),
                turned=float(best[i] / norm[i]),
                scale=float(scale[i]),
                sigma=float(sigma[i]),
                lidar=float(np.sqrt(own[i] / counts[i])),
                imu=float(np.sqrt(other[i] / counts[i])),
            )
            for i in np.flatnonzero(counts >= fewest).tolist()
        ]


def _between(sums: Array, low: NDArray[np.int64], high: NDArray[np.int64]) -> Array:
    """Differences of running sums; places outside are those at the ends."""
    between: Array = sums.take(high, mode='clip') - sums.take(low, mode='clip')
    return between


def smoothness(evidence: MotionEvidence) -> float:
    """Correlation of one match's rotation with the next one's: 1 where a car turns, 0 of noise."""
    turns = evidence.turns[np.argsort(evidence.spans.sum(axis=1), kind='stable')]
    return float((turns[1:] * turns[:-1]).sum() / max(float((turns**2).sum()), 1e-30))


def integrated(stamps: NDArray[np.int64], gyro: Array) -> Array:
    """Integral of the rates at each stamp (K, 4), rad; the last column is the time in holes, s."""
    passed = np.diff(stamps) / NANOSECONDS
    mean = 0.5 * (gyro[1:] + gyro[:-1]) * passed[:, None]
    steps = np.column_stack([mean, np.where(passed > MAX_HOLE, passed, 0.0)])
    return np.vstack([np.zeros(4), np.cumsum(steps, axis=0)])


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """How an IMU's axes stand, beside what the extrinsics say.

    Attributes:
        rotation: (3, 3), from where the extrinsics put the axes to where they are; it exchanges
            axes.
        sign: -1 where accelerations have the wrong sign.
        gain: Logarithm of the likelihood ratio to the extrinsics as they are.
        lead: The same to the next best exchange of axes.
        upright: Whether gravity then points up in base_link.
        was_upright: Whether it does as the extrinsics say.
        free: The rotation (3, 3) that fits best of all.
        free_gain: Logarithm of its likelihood ratio to the best exchange of axes.
        force_loss: Logarithm of the likelihood ratio of the extrinsics to ``rotation`` by
            acceleration alone.
        rates: (3, 3), the exchange of the gyroscope's axes alone, signs included, that fits best.
        rates_gain: Logarithm of its likelihood ratio to the next best.
    """

    rotation: Array
    sign: int
    gain: float
    lead: float
    upright: bool
    was_upright: bool
    free: Array
    free_gain: float
    force_loss: float
    rates: Array
    rates_gain: float

    @property
    def as_said(self) -> bool:
        """Whether the extrinsics are right."""
        return self.sign == 1 and bool((self.rotation == np.eye(3)).all())


def _exchanges() -> Array:
    """The 48 ways of naming and signing three axes, the identity first."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[range(3), order] = signs
        found.append(matrix)
    return np.array(sorted(found, key=lambda matrix: -np.trace(matrix)))


EXCHANGES = _exchanges()
"""Ways of exchanging axes (48, 3, 3), mirrored ones among them, the identity first."""
QUARTER_TURNS = EXCHANGES[np.linalg.det(EXCHANGES) > 0.0]
"""The rotations among them (24, 3, 3), the identity first."""
UPRIGHT = float(np.cos(np.radians(30.0)))
"""Cosine of the angle between gravity and the z axis of base_link, above which it points up."""
NOT_UPRIGHT = 40.0
"""What it costs a hypothesis, as a logarithm of a likelihood, if gravity does not point up."""


def compare_axes(evidence: MotionEvidence) -> Axes:
    """Try all ways of exchanging axes, with accelerations of either sign.

    Args:
        evidence: Matches and samples; the clocks and the units of the two agree.

    Returns:
        The best way.
    """
    lidar, imu = _turn_pairs(evidence)
    by_turn = lidar.T @ imu / _turn_variance(lidar, imu)
    seen, felt = force_pairs(evidence)
    if len(seen):
        seen, felt = seen - seen.mean(axis=0), felt - felt.mean(axis=0)
    by_force = seen.T @ felt / FORCE_SIGMA**2
    up = np.median(evidence.force, axis=0)
    size = float(np.linalg.norm(up))
    heights = QUARTER_TURNS[:, 2] @ up / max(size, 1e-12)
    upright = np.concatenate([heights, -heights]) > UPRIGHT
    if not 0.5 * evidence.gravity < size < 2.0 * evidence.gravity:  # it says nothing
        upright[:] = True
    fits = [
        np.einsum('kij,ij->k', QUARTER_TURNS, by_turn + sign * by_force) for sign in (1.0, -1.0)
    ]
    scores = np.concatenate(fits) - np.where(upright, 0.0, NOT_UPRIGHT)
    best, second = np.argsort(scores)[:-3:-1].tolist()
    sign = 1 if best < len(QUARTER_TURNS) else -1
    products = by_turn + sign * by_force
    free = best_rotation(products)
    turn = QUARTER_TURNS[best % len(QUARTER_TURNS)]
    alone = np.einsum('kij,ij->k', EXCHANGES, by_turn)
    first, next_best = np.argsort(alone)[:-3:-1].tolist()
    return Axes(
        rotation=turn,
        sign=sign,
        gain=float(scores[best] - scores[0]),
        lead=float(scores[best] - scores[second]),
        upright=bool(upright[best]),
        was_upright=bool(upright[0]),
        free=free,
        free_gain=float(((free - turn) * products).sum()),
        force_loss=float(((np.eye(3) - sign * turn) * by_force).sum()),
        rates=EXCHANGES[first],
        rates_gain=float(alone[first] - alone[next_best]),
    )


def _turn_pairs(evidence: MotionEvidence) -> tuple[Array, Array]:
    """Rotations (M, 3) of the matches that the samples cover, and the IMU's own."""
    low, high = evidence.spans.T
    keep = (
        (high - low < LONGEST * NANOSECONDS)
        & (np.linalg.norm(evidence.turns, axis=1) < LARGEST)
        & (low >= evidence.stamps[0])
        & (high <= evidence.stamps[-1])
    )
    start = int(evidence.stamps[0])
    moments, spans = (evidence.stamps - start) / NANOSECONDS, (evidence.spans[keep] - start) / 1e9
    table = integrated(evidence.stamps, evidence.gyro)
    found = np.stack([np.interp(spans, moments, c) for c in table.T])
    passed = (found[:, :, 1] - found[:, :, 0]).T
    whole = passed[:, 3] <= 0.0
    return evidence.turns[keep][whole], passed[whole, :3]


def _turn_variance(lidar: Array, imu: Array) -> float:
    """Variance of the difference between two rotations, per axis, with the axes that fit best."""
    rest = lidar - imu @ best_rotation(lidar.T @ imu).T
    return max(float((rest**2).mean()) if len(rest) else 0.0, TURN_SIGMA**2)


def best_rotation(products: Array) -> Array:
    """The rotation (3, 3) with the largest trace of R^T ``products`` (Wahba's problem)."""
    left, _, right = np.linalg.svd(products)
    flip = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(left @ right)))])
    rotation: Array = left @ flip @ right
    return rotation


def force_pairs(evidence: MotionEvidence) -> tuple[Array, Array]:
    """Accelerations of base_link by scan matching (M, 3), and the mean specific forces beside them.

    One for each second of the drive that has enough of both; gravity is in the second only.
    """
    start = int(evidence.stamps[0])
    seconds = (evidence.spans - start) / NANOSECONDS
    length = seconds[:, 1] - seconds[:, 0]
    keep = (length < LONGEST) & (length > 0.0)
    middle, length = seconds[keep].mean(axis=1), length[keep, None]
    velocity, rate = evidence.shifts[keep] / length, evidence.turns[keep] / length
    moments = (evidence.stamps - start) / NANOSECONDS
    block = np.floor(middle / BLOCK).astype(int)
    inside = (block >= 0) & (block <= moments[-1] / BLOCK)
    block, offset = block[inside], middle[inside] - (block[inside] + 0.5) * BLOCK
    velocity, rate = velocity[inside], rate[inside]
    count = int(moments[-1] / BLOCK) + 1

    def sums(index: NDArray[np.int64], *columns: Array) -> Array:
        return np.stack([np.bincount(index, column, count) for column in columns], axis=1)

    number = np.bincount(block, minlength=count)
    of = np.maximum(number, 1)[:, None]
    velocities, rates = sums(block, *velocity.T) / of, sums(block, *rate.T) / of
    times = sums(block, offset, offset**2) / of
    products = sums(block, *(offset * velocity.T)) / of
    spread = np.maximum(times[:, 1:] - times[:, :1] ** 2, 1e-12)
    seen = (products - times[:, :1] * velocities) / spread + np.cross(rates, velocities)
    own = np.floor(moments / BLOCK).astype(int)
    samples = np.bincount(own, minlength=count)
    felt = sums(own, *evidence.force.T) / np.maximum(samples, 1)[:, None]
    enough = (number >= 6) & (samples >= 5)
    return seen[enough], felt[enough]
