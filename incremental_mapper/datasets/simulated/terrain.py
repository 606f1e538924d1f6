"""The shape of the ground: a sum of long waves, smooth enough for a car to follow exactly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Waves with ``amplitudes`` (W,) metres, ``wavevectors`` (W, 2) rad/m, ``phases`` (W,)."""

    amplitudes: Array
    wavevectors: Array
    phases: Array

    def height(self, points: Array) -> Array:
        """Height (N,) in metres at points (N, 2)."""
        height: Array = np.sin(points @ self.wavevectors.T + self.phases) @ self.amplitudes
        return height

    def gradient(self, points: Array) -> Array:
        """Slope (N, 2) along x and y at points (N, 2)."""
        waves = np.cos(points @ self.wavevectors.T + self.phases) * self.amplitudes
        gradient: Array = waves @ self.wavevectors
        return gradient


def make_terrain(
    slope: float, wavelengths: tuple[float, float], rng: np.random.Generator
) -> Terrain:
    """Eight random waves, each at most ``slope`` steep, with ``wavelengths`` in metres."""
    count = 8
    numbers = 2.0 * np.pi / rng.uniform(*wavelengths, count)
    directions = rng.uniform(0.0, 2.0 * np.pi, count)
    return Terrain(
        amplitudes=slope / numbers,
        wavevectors=numbers[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=1),
        phases=rng.uniform(0.0, 2.0 * np.pi, count),
    )
