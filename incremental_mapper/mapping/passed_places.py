"""Where a drive has been, and whether it comes near to where it was long before."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.smoothing.graph_state import GraphState


class PassedPlaces:
    """Where the drive has been, a place each ``closure.map_length`` of way."""

    def __init__(self, config: Config) -> None:
        """Begin with none.

        Args:
            config: All settings.
        """
        self._settings = config.closure
        self._clusters: list[int] = []
        self._travelled: list[float] = []
        self._positions = np.zeros((64, 2))
        self._seen = 0
        self._way = 0.0
        self._last: NDArray[np.float64] | None = None

    def look(self, state: GraphState) -> bool:
        """Whether a new place lies near one that was passed long before.

        Args:
            state: G(t), whose poses that have left the lag are taken over.
        """
        near = False
        while self._seen < len(state.clusters):
            placed = state.clusters[self._seen]
            if state.in_lag(placed.id):
                break
            self._seen += 1
            here = state.pose(placed.id).translation()
            self._way += 0.0 if self._last is None else float(np.linalg.norm(here - self._last))
            self._last = here
            if self._travelled and self._way - self._travelled[-1] < self._settings.map_length:
                continue
            near |= self._near(here[:2])
            self._add(placed.id, here[:2])
        return near

    def again(self, state: GraphState) -> None:
        """Take over all poses anew, after the map has moved.

        Args:
            state: G(t).
        """
        for place, cluster in enumerate(self._clusters):
            self._positions[place] = state.pose(cluster).translation()[:2]
        if self._seen:
            self._last = state.pose(state.clusters[self._seen - 1].id).translation()

    def _near(self, here: NDArray[np.float64]) -> bool:
        settings = self._settings
        latest = self._way - settings.min_travel
        count = int(np.searchsorted(self._travelled, latest, side='right'))
        apart = np.linalg.norm(self._positions[:count] - here, axis=1)
        # Local maps are cut at other places than these: by half of one at both ends.
        return bool((apart < settings.radius + settings.map_length).any())

    def _add(self, cluster: int, here: NDArray[np.float64]) -> None:
        if len(self._clusters) == len(self._positions):
            self._positions = np.vstack([self._positions, np.zeros_like(self._positions)])
        self._positions[len(self._clusters)] = here
        self._clusters.append(cluster)
        self._travelled.append(self._way)
