"""Whether the vehicle stands: a zero-velocity test on IMU and scan matching together.

Either alone can be wrong: the IMU of a car at constant speed is as quiet as that of a parked one,
and matches read no motion in a tunnel whose walls all look alike.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES, ImuSeries
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS

SPAN = NANOSECONDS // 2
"""Nanoseconds that a vehicle must have been quiet for: a swing of its springs is over by then."""
KEPT = 2 * SPAN
"""Nanoseconds of the past that are looked at."""
FEWEST = 4
"""Samples of the IMU that tell anything."""
SHAKING = 0.3
"""m/s^2; standard deviation of an axis. Engines at rest shake by 0.05 to 0.2, roads by 0.5 to 2."""
TURNING = 0.02
"""rad/s; mean rate without the bias, which need not be known well yet."""
PUSH, SURE = 0.1, 3.0
"""m/s^2 by which the mean of a window differs from what was before it where a vehicle sets off, and
so many standard deviations of that mean on top."""
SPEED = 0.2
"""m/s that the graph may still say of a vehicle that stands: it brakes for a while longer than its
wheels, as far as a smoother can tell."""
START, DRIFT, WANDER = 0.05, 0.08, 0.012
"""Metres that the matches of one LiDAR may add up to: before the vehicle stands, in all, and on top
of that for each square root of a match. Matches of a VLP-16 at rest have errors of 2 to
20 mm, most of which go out again with the next match, and wander by 5 mm a match. A vehicle that
creeps comes further."""
SWING = 0.02
"""The same of their rotations, radians."""


@dataclass(frozen=True, slots=True)
class _Step:
    """What ``count`` matches of a LiDAR add up to by a scan's stamp (ns), since all was quiet."""

    stamp: int
    count: int
    motion: gtsam.Pose3


class Standstill:
    """Follows the windows, and tells of each whether the vehicle stood through it.

    ``crept`` says, after the first window in which it did not stand any more, how far each LiDAR
    had come before that window: a vehicle sets off a little before it is noticed, and one that
    creeps long before.
    """

    def __init__(self) -> None:
        """Nothing is known: a vehicle moves until it is shown that it stands."""
        self._samples = EMPTY_SERIES
        self._since: int | None = None
        self._ways: dict[str, deque[_Step]] = {}
        self._stood = False
        self.crept: Mapping[str, gtsam.Pose3] = {}

    def look(
        self,
        prepared: Sequence[Prepared],
        samples: ImuSeries,
        bias: gtsam.imuBias.ConstantBias,
        speed: float,
    ) -> bool:
        """Take in a window.

        Args:
            prepared: Its core measurements, in time order.
            samples: Its IMU samples.
            bias: The newest bias.
            speed: The newest speed that the graph knows, m/s.

        Returns:
            Whether the vehicle has stood for long enough at the end of the window, and all
            through the window.
        """
        self.crept = {}
        if not prepared:
            return False
        end = prepared[-1].core.stamp
        self._keep(samples, end)
        before = {name: list(steps) for name, steps in self._ways.items()}
        rests = speed <= SPEED and _rests(self._samples, len(samples.stamps), bias)
        if not (rests and self._add(prepared)):
            # By the matches it has crept since it was first quiet; else it has just set off.
            since = end - SPAN if not rests else 0
            if self._stood:
                self.crept = {name: _way(steps, since) for name, steps in before.items()}
            self.start_anew()
            return False
        if self._since is None:
            self._since = prepared[0].core.stamp
        self._stood = bool(self._ways) and end - self._since >= SPAN
        return self._stood

    def start_anew(self) -> None:
        """Forget how long the vehicle has been quiet."""
        self._since, self._ways, self._stood = None, {}, False

    def _keep(self, samples: ImuSeries, end: int) -> None:
        joined = ImuSeries(
            np.concatenate([self._samples.stamps, samples.stamps]),
            np.concatenate([self._samples.gyro, samples.gyro]),
            np.concatenate([self._samples.acceleration, samples.acceleration]),
        )
        self._samples = joined.since(end - KEPT)

    def _add(self, prepared: Sequence[Prepared]) -> bool:
        """Add a window's matches up; whether none of their LiDARs has moved."""
        since = prepared[0].core.stamp if self._since is None else self._since
        far = DRIFT if prepared[0].core.stamp - since >= SPAN else START
        for item in prepared:
            if not isinstance(item, PreparedScan) or not item.usable:
                continue
            if item.T_previous_current is None:
                return False
            steps = self._ways.setdefault(item.core.sensor, deque())
            last = steps[-1] if steps else _Step(0, 0, gtsam.Pose3())
            motion = last.motion.compose(item.T_previous_current)
            steps.append(_Step(item.core.stamp, last.count + 1, motion))
            while steps[0].stamp < item.core.stamp - KEPT:
                steps.popleft()
            turned = np.linalg.norm(gtsam.Rot3.Logmap(motion.rotation()))
            most = far + WANDER * np.sqrt(last.count + 1)
            if np.linalg.norm(motion.translation()) > most or turned > SWING:
                return False
        return True


def _way(steps: Sequence[_Step], since: int) -> gtsam.Pose3:
    """What the matches after ``since`` (ns) add up to."""
    earlier = [step.motion for step in steps if step.stamp <= since]
    start = earlier[-1] if earlier else gtsam.Pose3()
    return start.between(steps[-1].motion) if steps else gtsam.Pose3()


def _rests(samples: ImuSeries, new: int, bias: gtsam.imuBias.ConstantBias) -> bool:
    """Whether an IMU feels neither the road nor a turn, nor, in the ``new`` samples, a push."""
    if len(samples.stamps) < FEWEST or samples.stamps[-1] - samples.stamps[0] < SPAN // 2:
        return False
    rate: NDArray[np.float64] = samples.gyro.mean(axis=0) - bias.gyroscope()
    shaking = samples.acceleration.std(axis=0)
    quiet = np.linalg.norm(rate) < TURNING and (shaking < SHAKING).all()
    before, now = samples.acceleration[:-new], samples.acceleration[-new:]
    pushed = 0 < new < len(samples.stamps) and (
        np.linalg.norm(now.mean(axis=0) - before.mean(axis=0))
        > PUSH + SURE * np.linalg.norm(shaking) / np.sqrt(new)
    )
    return bool(quiet and not pushed)
