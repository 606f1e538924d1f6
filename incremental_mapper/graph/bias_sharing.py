"""Which bias the IMU spans of a window have: one that serves many of them, or one at each end."""

from collections.abc import Callable
from dataclasses import dataclass

from incremental_mapper.candidates.model import Candidate, Cluster, SpanBias
from incremental_mapper.config import GraphSettings
from incremental_mapper.config.pipeline import Strategy
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.measurements import NANOSECONDS


@dataclass(frozen=True, slots=True)
class BiasSharing:
    """How the spans of a window's candidates get their bias.

    A bias changes over minutes, and a variable at every end of a span says the same thing ten
    times a second.

    Attributes:
        use: Which bias the spans have.
        kept: Cluster of G(t-1) whose bias is kept, if it is.
    """

    use: SpanBias = SpanBias.EACH_END
    kept: int | None = None

    @property
    def shared(self) -> bool:
        """Whether all spans of a candidate have the same bias."""
        return self.use is not SpanBias.EACH_END

    def home(self, candidate: Candidate, number: Callable[[Cluster], int]) -> int | None:
        """Number of the cluster whose bias all spans of a candidate have.

        Args:
            candidate: A candidate of the window.
            number: Gives the number of one of its clusters.

        Returns:
            The number; None where every end of a span has its own, or there is no span.
        """
        if not self.shared or not candidate.connections:
            return None
        if self.kept is not None:
            return self.kept
        return number(candidate.clusters[candidate.connections[0].end])

    def new_home(self, candidate: Candidate, number: Callable[[Cluster], int]) -> int | None:
        """As ``home``, where that bias is a new one; None where no shared one starts."""
        return self.home(candidate, number) if self.use is SpanBias.NEW else None


def sharing(frontier: Frontier, stamp: int, graph: GraphSettings, strategy: str) -> BiasSharing:
    """Decide how the spans of a window get their bias.

    Args:
        frontier: What G(t-1) lets a factor touch.
        stamp: The window's first core measurement, ns.
        graph: ``bias_period``.
        strategy: The graph of base has a bias at every end of a span (paper, Base).

    Returns:
        The bias of G(t-1), until it has served for its period; then a new one.
    """
    if graph.bias_period == 0.0 or strategy == Strategy.BASE:
        return BiasSharing()
    serves = stamp - frontier.bias_stamp < graph.bias_period * NANOSECONDS
    if frontier.bias is None or not serves:
        return BiasSharing(SpanBias.NEW)
    return BiasSharing(SpanBias.KEPT, frontier.bias)
