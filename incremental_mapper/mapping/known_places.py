"""What G(t) knows of where its local maps lie."""

from collections.abc import Sequence

import gtsam
import numpy as np

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

    def certain(self, maps: Sequence[LocalMap], settings: ClosureSettings) -> bool:
        """Whether local maps of one place lie within ``closure.radius`` of each other for sure.

        So they do where fixes hold the drive all along. What looks alike and is thought to lie
        further away is then somewhere else, and need not be looked for.

        Args:
            maps: Local maps in the order of their way.
            settings: Those of closures.
        """
        # One place has local maps whose middles are half a length apart at the most.
        slack = settings.radius - settings.map_length / 2.0
        most = slack / (2.0 * SURE * np.sqrt(UNCERTAIN))  # both may be off
        latest = -np.inf
        for place in maps:
            if place is not maps[-1] and place.travelled - latest < LOOK:
                continue
            latest = place.travelled
            if self._covariances.position(pose_key(place.cluster)) > most:
                return False
        return True
