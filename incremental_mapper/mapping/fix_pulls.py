"""Fixes that are drawn away from the map little by little, as between houses.

From one fix to the next such a pull is no more than odometry may err, and every one agrees with
the one before. The map knows better: its newest pose, carried on by matches and IMU to the stamp of
a fix, is good to some centimetres, and the graph tells how good.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.fixes import Drawn
from incremental_mapper.frontend.front_end import Prepared, PreparedFix
from incremental_mapper.frontend.match_noise import loosest_shift, weak_directions
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.window_inputs import WindowInputs
from incremental_mapper.mapping.joining import antenna_covariance
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.graph_state import GraphState

SLACK = 0.3
"""Metres by which a fix may be off in any case: fixes of RTK wander by as much between houses."""
NOISES, FEW_NOISES = 3.0, 1.5
"""Standard deviations of the fix, and of where it should be, by which it may be off beside, and
from which on it is believed less: but never below ``NOISES`` of them alone. Where a receiver errs
by metres, a third of its fixes are 1.5 deviations off, and a map that begins with a wrong yaw would
believe itself instead of them."""
SPEED, BLIND_SPEED = 0.3, 2.0
"""m/s by which the way from the newest pose to the fix may be off, and without IMU and match."""
FEWEST = 3
"""Fixes that are off one after the other before they count as drawn away: one of a hundred is off
by chance, where a receiver errs by metres."""
AGREEING, LASTING = 8, 10.0
"""Fixes that are off alike, and seconds over which they are, until they are believed: then the map
has slipped, or the receiver has another datum."""
CONFIRMED = 3
"""Fixes that agree one after the other before any is doubted: a map that has just been turned into
ENU by two or three of them may be turned wrongly, and would leave all that follow."""
WIDER = 3.0
"""So many times as far as it is off, a fix is said to be uncertain: those of a pull all err to one
side."""


@dataclass(frozen=True, slots=True, eq=False)
class _Off:
    """Where a fix is beside where it should be: stamp (ns), and east and north (2,), metres."""

    stamp: int
    apart: NDArray[np.float64]


class FixPulls:
    """Looks at the fixes of each window before its candidates are made.

    ``told`` counts what was drawn away.
    """

    def __init__(self, lever_arm: NDArray[np.float64]) -> None:
        """Make ready for an antenna at (3,) in base_link, metres."""
        self.told = Drawn()
        self._arm = lever_arm
        self._newest = 0
        self._row: list[_Off] = []  # fixes one after the other that are off
        self._slipped = False
        self._agreed = 0  # one after the other, until there are enough
        # Metres by LiDAR that weak matches may have leant since a fix was believed.
        self._leaning: dict[str, float] = {}

    def look(
        self, items: Sequence[Prepared], state: GraphState, inputs: WindowInputs
    ) -> list[Prepared] | None:
        """Hold the fixes of a window against the map.

        Args:
            items: Core measurements of the window.
            state: G(t-1).
            inputs: What was made of the items, with predicted states.

        Returns:
            The items, with those less certain that are off; None where all stay as they are.
        """
        newest = state.frontier.newest
        if not state.georeferenced or newest is None:
            self._agreed = 0
            return None
        known: NDArray[np.float64] | None = None
        made = list(items)
        for place, item in enumerate(items):
            if isinstance(item, PreparedScan):
                self._lean(item)
            if not isinstance(item, PreparedFix) or item.core.stamp <= self._newest:
                continue
            if item.doubtful:
                continue
            self._newest = item.core.stamp
            known = antenna_covariance(state, newest, self._arm) if known is None else known
            apart, noise = self._beside(item, state, inputs, known[:2, :2])
            # All weak matches may be off to one side, which the graph takes for noise.
            noise += min(self._leaning.values(), default=0.0) / NOISES
            doubt = self.doubt(item.core.stamp, apart, noise, item.covariance)
            if not self._row:
                self._leaning.clear()
            if doubt > 0.0:
                wider = np.diag([doubt**2, doubt**2, 0.0])
                made[place] = replace(item, covariance=item.covariance + wider)
        return None if all(one is other for one, other in zip(made, items, strict=True)) else made

    def _lean(self, scan: PreparedScan) -> None:
        """Add what the match of a scan may be off where others are off to the same side."""
        if scan.covariance is None or scan.T_previous_current is None:
            return
        weak = bool(weak_directions(scan.covariance))
        off = np.sqrt(loosest_shift(scan.covariance)) if weak else 0.0
        sensor = scan.core.sensor
        self._leaning[sensor] = self._leaning.get(sensor, 0.0) + float(off)

    def _beside(
        self,
        item: PreparedFix,
        state: GraphState,
        inputs: WindowInputs,
        known: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], float]:
        """Where a fix is beside where it should be (2,), and the deviation of that, metres."""
        reached = inputs.states[item.core.stamp]
        apart = (item.enu + inputs.enu_offset - reached.pose.transformFrom(self._arm))[:2]
        seconds = max(item.core.stamp - state.frontier.newest_stamp, 0) / NANOSECONDS
        moved = SPEED * min(seconds, 1.0) + BLIND_SPEED * reached.unseen
        covariance = known + item.covariance[:2, :2] + moved**2 * np.eye(2)
        return apart, float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))

    def doubt(
        self,
        stamp: int,
        apart: NDArray[np.float64],
        noise: float,
        covariance: NDArray[np.float64],
    ) -> float:
        """Judge the next fix.

        Args:
            stamp: Its stamp, ns.
            apart: Where it is beside where it should be (2,), metres.
            noise: The deviation of that, metres.
            covariance: Of the fix (3, 3), m^2.

        Returns:
            Metres that are added to its deviation.
        """
        off = float(np.hypot(*apart))
        sigma = float(np.sqrt(covariance[:2, :2].max()))
        added = self._added(_Off(stamp, apart), off, noise, sigma)
        self.told.look(off if added > 0.0 else 0.0)
        return added

    def _added(self, one: _Off, off: float, noise: float, sigma: float) -> float:
        if self._agreed < CONFIRMED:
            self._agreed = self._agreed + 1 if off <= SLACK + NOISES * noise else 0
            return 0.0
        if off <= SLACK + NOISES * noise:
            self._slipped = False
            # Where a pull ends, what is left of it is within what is known by then.
            about = sigma if self._row else noise
            doubted = off > max(SLACK + FEW_NOISES * about, NOISES * about)
            if not doubted:
                self._row.clear()
            return off if doubted else 0.0
        if self._slipped:
            return 0.0
        self._row.append(one)
        if self._alike(SLACK + NOISES * sigma):
            self._slipped = True
            return 0.0
        if len(self._row) >= FEWEST:
            for drawn in self._row[-1:] if len(self._row) > FEWEST else self._row:
                self.told.add(drawn.stamp, float(np.hypot(*drawn.apart)))
        return WIDER * off

    def _alike(self, most: float) -> bool:
        """Whether the newest fixes have been off alike for long, by ``most`` metres."""
        last = self._row[-1].stamp
        row = [one for one in self._row if last - one.stamp <= LASTING * NANOSECONDS]
        whole = len(row) < len(self._row)  # older ones have gone
        self._row = row if whole else self._row
        places = np.array([one.apart for one in row])
        apart = np.linalg.norm(places - places.mean(axis=0), axis=1)
        return whole and len(row) >= AGREEING and bool(apart.max() <= most)
