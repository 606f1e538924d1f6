"""A look at an input before it is mapped: evidence of every sensor, and what the rules say of it.

``check`` shows it, ``map`` and ``evaluate`` without settings begin with it.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.checks.imu_motion import MotionEvidence
from incremental_mapper.config import Config, Sensor, Tree
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.sampling import (
    Sampled,
    SamplePlan,
    SensorKind,
    SensorSample,
    scans_of,
)
from incremental_mapper.datasets.source import Source, SourceInfo
from incremental_mapper.results.lidar_shape import LidarShape, lidar_shape
from incremental_mapper.results.starting_point import Choice, starting_point
from incremental_mapper.results.suspicions import suspicions
from incremental_mapper.results.turning import turning
from incremental_mapper.settings import make_config, merge

THOROUGH = SamplePlan(fixes=60)
"""What ``check`` reads: 10 s of a recording of any length, and fixes."""
BRIEF = SamplePlan(first=1.0, blocks=4, seconds=0.2, clouds=1, most=3)
"""What ``map`` reads before it begins: enough for the kind of each sensor and its units."""


@dataclass(frozen=True)
class Survey:
    """What a look at an input shows.

    Attributes:
        info: what opening it tells.
        config: the settings in force.
        samples: what was read of each sensor.
        truth: where its true trajectory is, '' where there is none.
        motion: rotations of the IMU beside those of matched scans, None where nothing was matched.
    """

    info: SourceInfo
    config: Config
    samples: tuple[SensorSample, ...]
    truth: str
    motion: MotionEvidence | None = None

    @cached_property
    def shapes(self) -> Mapping[str, LidarShape]:
        """What each LiDAR is like that has scans."""
        looks = {
            sample.sensor: lidar_shape(list(scans_of(sample)), self.pose(sample.sensor))
            for sample in self.samples
            if sample.kind is SensorKind.LIDAR
        }
        return {name: look for name, look in looks.items() if look is not None}

    @cached_property
    def start(self) -> tuple[Choice, ...]:
        """Settings that suit the sensors, apart from the defaults."""
        rates = [sample.rate for sample in self.samples if sample.kind is SensorKind.IMU]
        return starting_point(self.shapes, max(rates, default=0.0), os.cpu_count() or 1)

    @cached_property
    def suspicions(self) -> tuple[Finding, ...]:
        """What the sample shows to be wrong, beyond what opening the input found."""
        return ranked(suspicions(self.samples, self.config, self.motion))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All that is wrong with the input, the worst first."""
        return ranked([*self.info.findings, *self.suspicions])

    def pose(self, sensor: str) -> NDArray[np.float64]:
        """T_base_sensor (4, 4) in force."""
        return self.sensor(sensor).matrix()

    def sensor(self, name: str) -> Sensor:
        """The settings of a sensor."""
        sensors = {**self.config.lidars, 'imu': self.config.imu, 'gnss': self.config.gnss}
        return sensors.get(name, Sensor())

    def mended(self) -> tuple[Finding, ...]:
        """Findings of the sample that a run goes by; those of the opening are in force."""
        return tuple(found for found in self.suspicions if found.changes)

    def settings(self) -> Tree:
        """What a user without settings starts from: ``start``, and what the data prove."""
        tree: Tree = {}
        for choice in self.start:
            tree = merge(tree, choice.tree())
        for found in self.mended():
            tree = merge(tree, found.settings)
        return tree


def survey(
    source: Source, config: Config, plan: SamplePlan = THOROUGH, match: bool = True
) -> Survey:
    """Look at an input.

    Args:
        source: an opened input.
        config: the settings in force.
        plan: how much is read.
        match: whether some scans are matched, to hold the IMU against them.

    Returns:
        What was seen; of an input of a user's own class what it tells of itself.
    """
    if not isinstance(source, Sampled):
        return Survey(source.info, config, (), '')
    samples = source.sample(plan)
    motion = turning(source, samples, config) if match else None
    return Survey(source.info, config, samples, source.truth_place(), motion)


def look_at(path: Path, tree: Tree, where: str) -> Survey:
    """Open an input and look at it.

    Args:
        path: KAIST folder, bag, or folder of scans.
        tree: the user's settings.
        where: where they come from, for messages.

    Returns:
        What was seen.

    Raises:
        MapperError: the input or the settings cannot be used.
    """
    make_config(tree, where)
    source = open_source(path, tree)
    return survey(source, make_config(merge(source.info.settings, tree), where))
