"""Bridges: what ties measurements to the graph that nothing connects and that waited too long."""

from dataclasses import replace

import gtsam

from incremental_mapper.candidates.enumeration import base_candidate
from incremental_mapper.candidates.time_shift_search import by_time_shift
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.window_problem import WindowProblem


def bridged(choice: Choice, problem: WindowProblem, newest: gtsam.Pose3 | None) -> Choice:
    """The least shifted candidate, with bridges in place of what is missing.

    Args:
        choice: What the strategy made of the window; it has no winner.
        problem: The window's problem.
        newest: T_map_base of the newest cluster of G(t-1), None where there is none.

    Returns:
        The same choice with a winner, and a bridge for each of its unconnected components.
    """
    least = next(by_time_shift(problem.elements, problem.head, problem.imu))
    base = base_candidate(problem.elements, problem.head, problem.imu)
    best = min((least, base), key=lambda item: len(problem.unconnected(item)))
    bridges = (
        problem.factors.bridge(component[0], best.clusters[0], newest)
        for component in problem.unconnected(best)
    )
    return replace(choice, winner=best, solution=None, extra=tuple(bridges), score_name='bridged')
