"""What comes of a window: the winner, how it was found, and everything that was looked at."""

from dataclasses import dataclass

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.graph.factors import Factor
from incremental_mapper.scoring.verification import Verification
from incremental_mapper.smoothing.gauss_newton import Solved


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """One candidate that was looked at; what it did not get, such as a score, is None.

    ``tied`` says whether its score could not be told from the lowest, None where nobody asked.
    """

    candidate: Candidate
    connected: bool
    score: float | None = None
    solver_error: float | None = None
    tied: bool | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The winner of a window and how it was found.

    Attributes:
        winner: None where no candidate is connected.
        score: The winner's; None where it has none.
        score_name: What the score is, for the output.
        enumerated: Candidates that were looked at.
        connected: Those of them that are connected.
        solved: Those of them that were solved.
        cut: Whether there may be better ones that were not looked at.
        seconds: Seconds by stage.
        tried: All candidates that were looked at, in the order of their enumeration.
        solution: The winner as it was judged; None where its strategy solves no candidates.
        extra: Factors beside the winner's own, which hold what it leaves unconnected.
        consecutive: Whether the next window connects from the newest cluster, whatever it has.
        verification: Fast against direct MOM, where that was asked for.
        tied: Candidates whose scores could not be told from the lowest, that one included; 0 where
            nobody asked.
        saved: Vertices that the winner has less than the candidate with the lowest score.
    """

    winner: Candidate | None
    score: float | None
    score_name: str
    enumerated: int
    connected: int
    solved: int
    cut: bool
    seconds: dict[str, float]
    tried: tuple[Tried, ...]
    solution: Solved | None = None
    extra: tuple[Factor, ...] = ()
    consecutive: bool = False
    verification: Verification | None = None
    tied: int = 0
    saved: int = 0
