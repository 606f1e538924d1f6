"""A prior and a set of factors as one linear least-squares problem."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from incremental_mapper.smoothing.batch import LOOSE
from incremental_mapper.smoothing.normal_equations import best_step
from incremental_mapper.smoothing.tangent_layout import Array, Layout


class Prior:
    """The rows ``root`` (m, n) of a prior; their right-hand sides change with every step."""

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
    whitened factors. ``total`` (n,) is the step from the prior's values so far.
    """

    __slots__ = ('_prior', 'layout', 'rest', 'rows', 'total')

    def __init__(self, prior: Prior, layout: Layout, rows: Array, rest: Rest, total: Array) -> None:
        self._prior = prior
        self.layout = layout
        self.rows = rows
        self.rest = rest
        self.total = total

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
        """The best step from here and the system there, None where it would not be finite."""
        prior, rest = self._prior, self.rest
        found = best_step(
            (prior.root, rest.prior, prior.information),
            (1.0 / LOOSE, rest.loose),
            (self.rows, rest.factors),
        )
        if found is None:
            return None
        step, *left = found
        return step, self._there(step, Rest(*left))

    def moved(self, step: Array) -> 'System':
        """The same system seen from a place that is ``step`` (n,) away."""
        return self._there(step, self._after(step))

    def _after(self, step: Array) -> Rest:
        rest = self.rest
        return Rest(
            rest.prior - self._prior.root @ step[: self.known],
            rest.loose - step[self.known :] / LOOSE,
            rest.factors - self.rows @ step,
        )

    def _there(self, step: Array, rest: Rest) -> 'System':
        return System(self._prior, self.layout, self.rows, rest, self.total + step)

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
