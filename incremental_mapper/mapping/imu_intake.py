"""The IMU's samples in rad/s and m/s^2, without those that no IMU can have measured."""

from collections import Counter
from dataclasses import replace

import numpy as np

from incremental_mapper.config import Imu
from incremental_mapper.measurements import NANOSECONDS, Drops, ImuSample

FROZEN = NANOSECONDS // 2
"""Nanoseconds for which a sample is repeated bit for bit before it counts as frozen. A 10 Hz IMU
that is published at 100 Hz repeats for 0.1 s; none of the drives here repeats a sample at all."""


class ImuIntake:
    """Takes in samples one by one; ``drops`` counts those that are not used, by reason."""

    def __init__(self, settings: Imu, gravity: float) -> None:
        """Make ready for the first sample.

        Args:
            settings: What the samples are multiplied by, and whether they are used at all.
            gravity: Magnitude of gravity in them, m/s^2.
        """
        self.drops: Drops = Counter()
        self._settings = settings
        self._gravity = gravity
        self._scaled = settings.acceleration_scale != 1.0 or settings.rate_scale != 1.0
        self._last: tuple[float, ...] = ()
        self._since = 0

    def take(self, sample: ImuSample) -> ImuSample | None:
        """Make a sample ready to be used.

        Args:
            sample: As the message has it.

        Returns:
            The sample in rad/s and m/s^2; None where it is not to be used.
        """
        settings = self._settings
        if not settings.enabled:
            self.drops[sample.sensor, 'switched_off'] += 1
            return None
        # There are hundreds a second: on plain floats this is several times as quick.
        rate, force = sample.gyro.tolist(), sample.acceleration.tolist()
        fastest = settings.rate_scale * max(map(abs, rate))
        strongest = abs(settings.acceleration_scale) * max(map(abs, force))
        if fastest > settings.max_rate or strongest > settings.max_acceleration:
            self.drops[sample.sensor, 'implausible'] += 1
            return None
        values = (*rate, *force)
        if values != self._last:
            self._last, self._since = values, sample.stamp
        elif sample.stamp - self._since > FROZEN and not self._rests(sample, fastest):
            self.drops[sample.sensor, 'frozen'] += 1
            return None
        if not self._scaled:
            return sample
        return replace(
            sample,
            gyro=settings.rate_scale * sample.gyro,
            acceleration=settings.acceleration_scale * sample.acceleration,
        )

    def _rests(self, sample: ImuSample, fastest: float) -> bool:
        """Whether it is what an IMU without noise, a simulated one, says while it stands."""
        force = abs(self._settings.acceleration_scale) * float(np.linalg.norm(sample.acceleration))
        return fastest == 0.0 and abs(force - self._gravity) < 0.1 * self._gravity
