"""What G(t) knows of where its local maps lie."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.closures.candidate_pairs import Known
from incremental_mapper.closures.local_maps import LocalMap
from incremental_mapper.closures.verification import SURE, UNCERTAIN
from incremental_mapper.config import ClosureSettings
from incremental_mapper.graph.factors import Factor
from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
from incremental_mapper.variables import pose_key

LOOK = 100.0
"""Metres of way between two local maps whose places are asked for: between them odometry knows."""


class KnownPlaces:
    """The places of the local maps of one G(t), as well as its factors know them."""

    def __init__(self, factors: Sequence[Factor], values: gtsam.Values) -> None:
        """Linearise and factorise; costs about one step of a solve.

        Args:
            factors: All factors.
            values: Their optimum.

        Raises:
            RuntimeError: The system is singular.
        """
        self._covariances = RelativeCovariances((factor.factor for factor in factors), values)

    def relative(self, first: LocalMap, second: LocalMap) -> Known:
        """What is known of the relative pose of two local maps.

        Args:
            first: One.
            second: Another.
        """
        covariance = self._covariances.relative(pose_key(first.cluster), pose_key(second.cluster))
        return Known(first.T_map_base.between(second.T_map_base), covariance)

    def unsure(self, maps: Sequence[LocalMap], settings: ClosureSettings) -> list[int]:
        """Which local maps may show a place of another one that is thought to lie further away.

        Where fixes hold the drive all along, local maps of one place lie within ``closure.radius``
        of each other for sure, and there are none. What looks alike is then somewhere else.

        Args:
            maps: Local maps in the order of their way.
            settings: Those of closures.

        Returns:
            Their places in ``maps``.
        """
        # One place has local maps whose middles are half a length apart at the most.
        beside = settings.map_length / 2.0
        reach = SURE * np.sqrt(UNCERTAIN) * self._positions(maps)
        places = np.array([one.T_map_base.translation()[:2] for one in maps]).reshape(-1, 2)
        ways = np.array([one.travelled for one in maps])
        found: list[int] = []
        for number, own in enumerate(reach):
            both = reach + own  # both may be off
            apart = np.linalg.norm(places - places[number], axis=1)
            further = (both > settings.radius - beside) & (apart <= both + beside)
            if (further & (np.abs(ways - ways[number]) >= settings.min_travel)).any():
                found.append(number)
        return found

    def _positions(self, maps: Sequence[LocalMap]) -> NDArray[np.float64]:
        """Standard deviations (N,) of where the local maps lie, metres; some are asked for."""
        asked: list[int] = []
        for number, one in enumerate(maps):
            if not asked or one is maps[-1] or one.travelled - maps[asked[-1]].travelled >= LOOK:
                asked.append(number)
        known = [self._covariances.position(pose_key(maps[number].cluster)) for number in asked]
        # Between two of them it is no better than at the worse one.
        after = np.searchsorted(asked, np.arange(len(maps)))
        before = np.searchsorted(asked, np.arange(len(maps)), side='right') - 1
        values = np.array(known)
        worse: NDArray[np.float64] = np.maximum(values[before], values[after])
        return worse
