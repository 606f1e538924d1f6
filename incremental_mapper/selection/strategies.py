"""The strategies, and how they are found: a strategy is a criterion plus a search.

Those of the paper are here, and ``fewest``, the baseline that any metric must beat. Others come in
by the entry-point group ``incremental_mapper.strategies`` of any installed package: each entry
names a ``Strategy`` under the name that ``selection.strategy`` asks for.
"""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol

from incremental_mapper.config import Strategy as Name
from incremental_mapper.config import Tree
from incremental_mapper.errors import ConfigError
from incremental_mapper.scoring.criteria import SOLVER_ERROR
from incremental_mapper.selection.base_graph import BaseGraph
from incremental_mapper.selection.cheapest import FewestVertices, LeastTimeShift
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.lowest_score import LowestScore, lowest_mom
from incremental_mapper.selection.window_problem import WindowProblem

GROUP = 'incremental_mapper.strategies'
"""Entry points of other packages."""


class Strategy(Protocol):
    """Decides which candidate a window keeps; has no state of its own."""

    def select(self, problem: WindowProblem) -> Choice:
        """Choose a candidate.

        Args:
            problem: The window: its elements, their factors, what candidates are judged on.

        Returns:
            The choice; without a winner the window's measurements wait for the next one.
        """

    def warm_up(self) -> None:
        """Compile or load what the first window would else wait for."""


BUILT_IN: dict[str, Strategy] = {
    Name.MOM: lowest_mom,
    Name.BASE: BaseGraph(),
    Name.MIN_TIME_SHIFT: LeastTimeShift(),
    Name.MIN_SOLVER_ERROR: LowestScore(lambda *_: SOLVER_ERROR),
    Name.FEWEST: FewestVertices(),
}


def find_strategy(name: str) -> Strategy:
    """The strategy of a name.

    Args:
        name: One of the built-in ones, or that of an entry point.

    Returns:
        The strategy; the same object for the same name.

    Raises:
        ConfigError: Where there is none of that name, two packages have one, or it cannot be
            imported.
    """
    return BUILT_IN[name] if name in BUILT_IN else _load(name)


def strategy_names() -> list[str]:
    """The strategies that are installed.

    Returns:
        Their names, the built-in ones first.
    """
    others = {entry.name for entry in entry_points(group=GROUP)} - set(BUILT_IN)
    return [*map(str, BUILT_IN), *sorted(others)]


def labelled(label: str) -> tuple[str, Tree]:
    """The strategy of a label, and the settings that choose it.

    Args:
        label: A name, or a name and a confidence of its ties such as ``mom@0.9``.

    Returns:
        The name, and ``selection`` with it and with ``tie_confidence`` where the label has one.

    Raises:
        ConfigError: What stands behind the @ is no confidence.
    """
    name, mark, text = label.partition('@')
    tree: Tree = {'strategy': name}
    if mark:
        try:
            tree['tie_confidence'] = float(text)
        except ValueError as error:
            raise ConfigError(f'{label!r}: {text!r} is no confidence such as 0.9') from error
    return name, {'selection': tree}


@cache
def _load(name: str) -> Strategy:
    found = entry_points(group=GROUP, name=name)
    places = sorted({entry.value for entry in found})
    if not places:
        known = ', '.join(strategy_names())
        raise ConfigError(f'selection.strategy is {name!r}; known strategies: {known}')
    if len(places) > 1:
        raise ConfigError(
            f'selection.strategy is {name!r}, which is {" and ".join(places)}; '
            'uninstall one of them'
        )
    entry: EntryPoint = next(iter(found))
    try:
        strategy: Strategy = entry.load()
    # A user's module may raise anything on import.
    except Exception as error:
        raise ConfigError(
            f'strategy {name!r} cannot be loaded from {entry.value}: {error!r}'
        ) from error
    if isinstance(strategy, type) or not callable(getattr(strategy, 'select', None)):
        raise ConfigError(
            f'strategy {name!r}: {entry.value} is no object with a method select(problem)'
        )
    return strategy
