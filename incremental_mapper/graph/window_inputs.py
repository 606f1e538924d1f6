"""What the factors of a window are made of."""

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.frontend.dead_reckoning import State
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.graph.bias_sharing import BiasSharing
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.graph.passed_clusters import MotionSigmas


@dataclass(frozen=True, slots=True, eq=False)
class WindowInputs:
    """Everything that the factors of a window are made of.

    Attributes:
        prepared: The core measurements with what the front end made of them.
        states: Predicted states at their stamps (ns).
        series: IMU samples that no span has used yet.
        parameters: Noise and gravity of the pre-integration.
        frontier: What G(t-1) lets a factor touch.
        head_state: State of the cluster of G(t-1) to connect from, or the first one of all.
        scan_offsets: T_cluster_scan of each LiDAR's last scan in G(t-1), by sensor and stamp.
        enu_offset: Where ENU's origin lies in the map, (3,) metres; the axes are the same.
        fix_inflation: Extra standard deviations of fixes, horizontal and vertical, by stamp.
        known: How well the motion of ``head_state`` is known.
        bias: Which bias the spans have.
        config: All settings.
    """

    prepared: Mapping[CoreMeasurement, Prepared]
    states: Mapping[int, State]
    series: ImuSeries
    parameters: gtsam.PreintegrationCombinedParams
    frontier: Frontier
    head_state: State
    scan_offsets: Mapping[tuple[str, int], gtsam.Pose3]
    enu_offset: NDArray[np.float64]
    fix_inflation: Mapping[int, tuple[float, float]]
    known: MotionSigmas
    bias: BiasSharing
    config: Config
