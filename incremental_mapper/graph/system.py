"""A belief and a set of factors as one linear least-squares problem."""

from collections.abc import Sequence

import numpy as np

from incremental_mapper.graph.linear import Array, Cholesky, Indices, Layout
from incremental_mapper.graph.solver import LOOSE


class System:
    """Belief, loose hold on new variables and factors as ‖root · δ − rhs‖², and how far it moved.

    The first ``known`` columns are the belief's variables, the last rows the factors'. ``total``
    (n,) is the step from the belief's values so far.
    """

    __slots__ = ('_factor', '_held', 'known', 'layout', 'rhs', 'root', 'total')

    def __init__(
        self, root: Array, rhs: Array, layout: Layout, blocks: Sequence[tuple[Indices, Array]]
    ) -> None:
        """``root`` (m, known) and ``rhs`` (m,) are the belief's.

        Every block is a few whitened rows (r, k + 1) of factors with their right-hand side last,
        and the columns (k,) that they stand in.
        """
        self.known = root.shape[1]
        self.layout = layout
        self._held = len(root) + layout.size - self.known
        rows = self._held + sum(len(block) for _, block in blocks)
        self.root = np.zeros((rows, layout.size))
        self.rhs = np.zeros(rows)
        self.total = np.zeros(layout.size)
        self.root[: len(root), : self.known] = root
        self.rhs[: len(root)] = rhs
        new = np.arange(layout.size - self.known)
        self.root[len(root) + new, self.known + new] = 1.0 / LOOSE
        self._factor: Cholesky | None = None
        self._fill(blocks)

    @property
    def prior_error(self) -> float:
        """What belief and loose hold say against the step so far."""
        rest = self.rhs[: self._held]
        return float(rest @ rest)

    @property
    def error(self) -> float:
        """Σ‖h(x)−z‖²_Σ of the factors, as far as they are linear."""
        rest = self.rhs[self._held :]
        return float(rest @ rest)

    @property
    def cost(self) -> float:
        """Both together."""
        return float(self.rhs @ self.rhs)

    def best(self) -> tuple[Array, 'System'] | None:
        """The best step from here and the system there, None where it would not be finite.

        Normal equations square the condition of ``root``, which short IMU spans make large; what
        that costs is made good by solving once more for what the first solution leaves.
        """
        try:
            factor = self._factor or Cholesky(self.root.T @ self.root)
        except ValueError:
            return None
        self._factor = factor
        step = factor.solve(self.root.T @ self.rhs)
        if step is None:
            return None
        rest = self.rhs - self.root @ step
        more = factor.solve(self.root.T @ rest)
        if more is not None:
            step, rest = step + more, rest - self.root @ more
        return step, self._there(step, rest)

    def moved(self, step: Array) -> 'System':
        """The same system seen from a place that is ``step`` (n,) away."""
        return self._there(step, self.rhs - self.root @ step)

    def _there(self, step: Array, rhs: Array) -> 'System':
        other = self._copy()
        other.rhs, other.total = rhs, self.total + step
        return other

    def relinearized(self, blocks: Sequence[tuple[Indices, Array]]) -> 'System':
        """The same system with the factors as they are linearised elsewhere."""
        other = self._copy()
        other.root, other.rhs = self.root.copy(), self.rhs.copy()
        other._fill(blocks)
        return other

    def _fill(self, blocks: Sequence[tuple[Indices, Array]]) -> None:
        end = self._held
        for columns, rows in blocks:
            start, end = end, end + len(rows)
            self.root[start:end, columns] = rows[:, :-1]
            self.rhs[start:end] = rows[:, -1]
        self._factor = None

    def without_nonsense(self) -> 'System':
        """The same system without rows that are not finite."""
        other = self._copy()
        finite = np.isfinite(self.root).all(axis=1) & np.isfinite(self.rhs)
        other.root, other.rhs = self.root[finite], self.rhs[finite]
        other._held = int(np.count_nonzero(finite[: self._held]))
        other._factor = None
        return other

    def _copy(self) -> 'System':
        other = object.__new__(System)
        for name in System.__slots__:
            setattr(other, name, getattr(self, name))
        return other
