"""A criterion of one's own: the solver error, plus a price for every variable.

Install it beside the package and name it like any other strategy:

    pip install ./examples/my_criterion
    incremental_mapper map DRIVE OUT --strategy penalised_error

The name stands in ``pyproject.toml``, in the entry-point group ``incremental_mapper.strategies``.
"""

from incremental_mapper import LowestScore, Proposal

PRICE = 2.0
"""Solver error that a variable must save to be worth having, as in Akaike's criterion."""


def score(proposal: Proposal) -> float:
    """Score of a connected, solved candidate; the lowest one wins.

    Args:
        proposal: Its clusters and connections, Σ‖h(x)−z‖²_Σ of its factors, and the solved poses
            of its scans, which are computed when they are asked for.
    """
    assert proposal.solver_error is not None
    return proposal.solver_error + PRICE * proposal.candidate.vertices


penalised_error = LowestScore.of('penalised_error', score)
