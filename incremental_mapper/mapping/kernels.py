"""What is compiled, made ready before the first window."""

from incremental_mapper.compiled import waiting
from incremental_mapper.scoring import mom
from incremental_mapper.smoothing import normal_equations


def load_kernels(scoring: bool = True) -> None:
    """Compile what windows need, or load it from disk, so that none of them waits for that.

    Without ``scoring``, only what solving needs.
    """
    with waiting():
        normal_equations.warm_up()
        if scoring:
            mom.warm_up()
