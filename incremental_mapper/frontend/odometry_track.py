"""The way of the car by scan matching alone: what fixes are held against."""

from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.frontend.match_noise import loosest_shift, weak_directions
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where odometry puts the antenna at a stamp.

    Attributes:
        stamp: Nanoseconds.
        position: Position (3,) in a frame of odometry's own, metres.
        heading: Yaw of base_link there, radians.
        way: Metres that base_link has travelled since the start.
        blind: Seconds since the start for which there was no odometry.
        ahead: Seconds since the newest scan, over which the last motion goes on.
        loose: Variance of the way since the start, m^2, where the scans held matches weakly.
        looser: The sum of the deviations there, metres, which is what it is off if all of them err
            to one side.
        unknown: Seconds since the beginning for which there was no motion to go on with: the first
            scans came later.
        speed: The first motion's, m/s, which the car may have had then; infinite before that.
        lost: Radians that the car has turned, or not, where the last motion went on.
    """

    stamp: int
    position: NDArray[np.float64]
    heading: float
    way: float
    blind: float
    ahead: float
    loose: float
    looser: float
    unknown: float = 0.0
    speed: float = np.inf
    lost: float = 0.0


class OdometryTrack:
    """Joins the odometry of all LiDARs into one track; no fix and no IMU takes part.

    One LiDAR's chain leads as long as it is not interrupted, since two chains drift apart. Where
    there is no odometry the last motion goes on, and the seconds are counted as blind.
    """

    def __init__(self, lever_arm: NDArray[np.float64]) -> None:
        """Begin a track.

        Args:
            lever_arm: The antenna in base_link (3,), metres.
        """
        self._arm = lever_arm
        self._scans: dict[str, tuple[int, gtsam.Pose3]] = {}  # each LiDAR's newest
        self._leader = ''
        self._pose = gtsam.Pose3()
        self._stamp: int | None = None
        self._twist = np.zeros(6)
        self._way = 0.0
        self._blind = 0.0
        self._loose = 0.0
        self._looser = 0.0
        self._lost = 0.0
        # Deviations of the last motion where its match was held weakly, m and m/s.
        self._weak, self._unsure = 0.0, 0.0
        self._began: int | None = None
        self._unknown: float | None = None  # until there is a motion
        self._speed = np.inf

    @property
    def stamp(self) -> int | None:
        """Stamp of the newest scan that led on, ns."""
        return self._stamp

    @property
    def way(self) -> float:
        """Metres that base_link has travelled until then."""
        return self._way

    def add(self, scan: PreparedScan) -> None:
        """Go on with the next scan in time order."""
        sensor, stamp = scan.core.sensor, scan.core.stamp
        if self._stamp is None:
            self._stamp = stamp
            self._began = stamp if self._began is None else self._began
        known = self._scans.get(sensor)
        if known is not None and known[0] == scan.previous:
            before, pose = known
            assert scan.T_previous_current is not None
            if self._leader in ('', sensor) or self._stamp <= before:
                self._lead(sensor, before, stamp, pose, scan.T_previous_current)
                self._weak, self._unsure = 0.0, 0.0
                if scan.covariance is not None and weak_directions(scan.covariance):
                    weakest = loosest_shift(scan.covariance)
                    self._loose += weakest
                    self._weak = float(np.sqrt(weakest))
                    self._looser += self._weak
                    self._unsure = self._weak / ((stamp - before) / NANOSECONDS)
        elif sensor == self._leader:
            self._leader = ''
        if scan.usable:
            self._scans[sensor] = (stamp, self._at(stamp))

    def _lead(
        self, sensor: str, before: int, stamp: int, pose: gtsam.Pose3, motion: gtsam.Pose3
    ) -> None:
        """Go on with a LiDAR's motion from its scan ``before`` at ``pose``."""
        assert self._stamp is not None and self._began is not None
        blind = max(before - self._stamp, 0) / NANOSECONDS
        self._blind += blind
        self._loose += self._variance(blind)
        self._looser += self._unsure * blind
        self._lost += blind * float(np.linalg.norm(self._twist[:3]))
        there = pose.compose(motion)
        self._way += float(np.linalg.norm(there.translation() - self._pose.translation()))
        self._twist = gtsam.Pose3.Logmap(motion) / ((stamp - before) / NANOSECONDS)
        self._pose, self._stamp, self._leader = there, stamp, sensor
        if self._unknown is None:
            self._unknown = (before - self._began) / NANOSECONDS
            self._speed = float(np.linalg.norm(self._twist[3:]))

    def at(self, stamp: int) -> Place:
        """The antenna at a stamp, not before the newest scan."""
        ahead = 0.0 if self._stamp is None else max(stamp - self._stamp, 0) / NANOSECONDS
        self._began = stamp if self._began is None else self._began
        unknown = (stamp - self._began) / NANOSECONDS if self._unknown is None else self._unknown
        pose = self._at(stamp)
        return Place(
            stamp=stamp,
            position=np.asarray(pose.transformFrom(self._arm)),
            heading=float(pose.rotation().yaw()),
            way=self._way + ahead * float(np.linalg.norm(self._twist[3:])),
            blind=self._blind,
            ahead=ahead,
            loose=self._loose + self._variance(ahead),
            looser=self._looser + self._unsure * ahead,
            unknown=unknown,
            speed=self._speed,
            lost=self._lost + ahead * float(np.linalg.norm(self._twist[:3])),
        )

    def _variance(self, seconds: float) -> float:
        """What the way's variance grows by where the last motion goes on: its error goes on too."""
        further = self._unsure * seconds
        return (2.0 * self._weak + further) * further

    def _at(self, stamp: int) -> gtsam.Pose3:
        if self._stamp is None:
            return self._pose
        seconds = (stamp - self._stamp) / NANOSECONDS
        return self._pose.compose(gtsam.Pose3.Expmap(self._twist * seconds))
