"""A belief and a set of factors as one linear least-squares problem."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from incremental_mapper.graph.linear import Array, Cholesky, Layout
from incremental_mapper.graph.solver import LOOSE


class Prior:
    """What a belief says of a step δ (n,) of its variables: ‖root · δ − rhs‖²."""

    def __init__(self, root: Array) -> None:
        self.root = root

    @cached_property
    def information(self) -> Array:
        """rootᵀ · root (n, n), computed once for all systems with this prior."""
        information: Array = self.root.T @ self.root
        return information


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """Right-hand sides: of the prior, of the loose hold on new variables, and of the factors."""

    prior: Array
    loose: Array
    factors: Array


class System:
    """Prior, loose hold on new variables and factors, and how far the variables moved.

    The prior's variables are the first ``known`` ones of the ``layout``. ``rows`` (r, n) are the
    whitened factors. ``total`` (n,) is the step from the belief's values so far.
    """

    __slots__ = ('_factor', '_prior', 'layout', 'rest', 'rows', 'total')

    def __init__(self, prior: Prior, layout: Layout, rows: Array, rest: Rest, total: Array) -> None:
        self._prior = prior
        self.layout = layout
        self.rows = rows
        self.rest = rest
        self.total = total
        self._factor: Cholesky | None = None

    @property
    def known(self) -> int:
        """Size of the prior's variables."""
        return int(self._prior.root.shape[1])

    @property
    def prior_error(self) -> float:
        """What prior and loose hold say against the step so far."""
        rest = self.rest
        return float(rest.prior @ rest.prior + rest.loose @ rest.loose)

    @property
    def error(self) -> float:
        """Σ‖h(x)−z‖²_Σ of the factors, as far as they are linear."""
        return float(self.rest.factors @ self.rest.factors)

    @property
    def cost(self) -> float:
        """Both together."""
        return self.prior_error + self.error

    def best(self) -> tuple[Array, 'System'] | None:
        """The best step from here and the system there, None where it would not be finite.

        Normal equations square the condition of the rows, which short IMU spans make large; what
        that costs is made good by solving once more for what the first solution leaves.
        """
        if self._factor is None:
            information = self.rows.T @ self.rows
            known = self.known
            information[:known, :known] += self._prior.information
            new = np.arange(known, len(information))
            information[new, new] += 1.0 / LOOSE**2
            try:
                self._factor = Cholesky(information)
            except ValueError:
                return None
        step = self._factor.solve(self._slope(self.rest))
        if step is None:
            return None
        rest = self._after(step)
        more = self._factor.solve(self._slope(rest))
        if more is not None:
            step, rest = step + more, self._after(step + more)
        return step, self._there(step, rest)

    def moved(self, step: Array) -> 'System':
        """The same system seen from a place that is ``step`` (n,) away."""
        return self._there(step, self._after(step))

    def _slope(self, rest: Rest) -> Array:
        slope: Array = rest.factors @ self.rows
        slope[: self.known] += rest.prior @ self._prior.root
        slope[self.known :] += rest.loose / LOOSE
        return slope

    def _after(self, step: Array) -> Rest:
        rest = self.rest
        return Rest(
            rest.prior - self._prior.root @ step[: self.known],
            rest.loose - step[self.known :] / LOOSE,
            rest.factors - self.rows @ step,
        )

    def _there(self, step: Array, rest: Rest) -> 'System':
        other = System(self._prior, self.layout, self.rows, rest, self.total + step)
        other._factor = self._factor
        return other

    def relinearized(self, rows: Array, rhs: Array) -> 'System':
        """The same system with the factors linearised elsewhere: ``rows`` (r, n), ``rhs`` (r,)."""
        rest = replace(self.rest, factors=rhs)
        return System(self._prior, self.layout, rows, rest, self.total)

    def stacked(self) -> tuple[Array, Array]:
        """All of it as ‖root · δ − rhs‖²: ``root`` (m, n) and ``rhs`` (m,).

        Rows that are not finite are left out.
        """
        known, rest, size = self.known, self.rest, self.layout.size
        held, new = len(rest.prior), np.arange(size - known)
        root = np.zeros((held + len(new) + len(self.rows), size))
        root[:held, :known] = self._prior.root
        root[held + new, known + new] = 1.0 / LOOSE
        root[held + len(new) :] = self.rows
        rhs = np.concatenate([rest.prior, rest.loose, rest.factors])
        finite = np.isfinite(rhs) & np.isfinite(root).all(axis=1)
        return (root, rhs) if finite.all() else (root[finite], rhs[finite])
