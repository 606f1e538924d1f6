"""Settings of the sensors."""

from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from incremental_mapper.config.sections import Section, Transform
from incremental_mapper.geometry import pose_matrix

MOST_OFFSET = 2.0**32
"""Upper limit of ``time_offset`` in seconds: stamps of ROS hold 32 bits of them."""


@lru_cache(maxsize=64)
def _matrix(numbers: tuple[float, ...]) -> NDArray[np.float64]:
    """``pose_matrix``, once for each pose: windows ask for the same few again and again."""
    return pose_matrix(numbers)


class Sensor(Section):
    """Where one sensor's messages come from and where it sits on the car."""

    topic: str = ''
    """Topic of the bag or the node's input; empty picks the only topic of the right type."""
    T_base_sensor: Transform = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    """Pose of the sensor in base_link: x, y, z, qx, qy, qz, qw, or a row-major 3x4 matrix."""
    time_offset: float = Field(default=0.0, ge=-MOST_OFFSET, le=MOST_OFFSET, allow_inf_nan=False)
    """Seconds added to every header stamp of this sensor; as a double it is exact to 0.5
    microseconds even where the clock counts from power-up."""

    def matrix(self) -> NDArray[np.float64]:
        """T_base_sensor as a (4, 4) homogeneous matrix."""
        return _matrix(self.T_base_sensor).copy()


class LidarSensor(Sensor):
    """A LiDAR."""

    scale: float = Field(default=1.0, gt=0.0, le=1e6, allow_inf_nan=False)
    """Factor that makes metres of x, y and z: 0.3048 where they are in feet."""
    sectors: bool = False
    """Its clouds are parts of a sweep, to be gathered into whole ones; a bag shows it by itself."""


class Imu(Sensor):
    """The IMU: as any sensor, with what its messages' numbers are to be multiplied by."""

    enabled: bool = True
    """Use the IMU."""
    acceleration_scale: float = Field(default=1.0, ge=-1e6, le=1e6, allow_inf_nan=False)
    """Factor that makes m/s^2, upwards at rest, of the accelerations: 9.80665 where they are in g,
    0.00980665 in milli-g, -1 where gravity has the wrong sign."""
    rate_scale: float = Field(default=1.0, gt=0.0, le=1e6, allow_inf_nan=False)
    """Factor that makes rad/s of the angular rates: 0.0174533 where they are in deg/s."""
    max_rate: float = Field(default=80.0, gt=0.0, le=1e6)
    """Samples with an angular rate above it, in rad/s, are left out: no gyroscope measures 80; less
    where it clips."""
    max_acceleration: float = Field(default=400.0, gt=0.0, le=1e9)
    """The same for accelerations, m/s^2: few IMUs measure more than 157 (16 g)."""

    @model_validator(mode='after')
    def _check_scale(self) -> Self:
        if self.acceleration_scale == 0.0:
            raise ValueError('acceleration_scale is 0; enabled: false leaves the IMU out')
        return self
