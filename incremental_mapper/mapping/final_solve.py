"""The last solve of all of G(t), for what is saved."""

import gtsam

from incremental_mapper.config import Config
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.graph_state import GraphState

MOST_ITERATIONS = 100


def final_values(state: GraphState, config: Config) -> tuple[gtsam.Values, bool]:
    """Newest estimates of all variables, optimised together if the settings say so.

    Args:
        state: G(t), which stays as it is.
        config: All settings.

    Returns:
        The values, and whether they could not be optimised and are those of the windows.
    """
    values = state.all_values()
    if not config.graph.final_optimization or not state.clusters:
        return values, False
    everything = make_graph(
        factor.factor for factor in (*state.factors.unpacked(), *state.closures)
    )
    solution = optimize(everything, values, MOST_ITERATIONS)
    return (values, True) if solution is None else (solution.values, False)
