"""Going on from a saved map: the session before, and the map of both."""

from collections import Counter
from dataclasses import asdict, dataclass, replace

import numpy as np

from incremental_mapper.checks.finding import Finding, Severity, ranked
from incremental_mapper.config import Config, Tree
from incremental_mapper.errors import ConfigError, InputError, MapperError
from incremental_mapper.frontend.gnss import Datum, fixed_datum
from incremental_mapper.map.store import make_store
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.results.run_statistics import InputFacts
from incremental_mapper.results.sessions.joining import alone, joined
from incremental_mapper.results.sessions.same_fixes import measured_twice
from incremental_mapper.results.sessions.saved_run import SavedRun, read_saved_run
from incremental_mapper.results.sessions.seam import seam_factors
from incremental_mapper.results.sessions.ties import disagreement, find_ties, tie_factors

APART, REPEATED = 'session_apart', 'session_repeated'
"""The findings of a session that does not know where it is in the map before, and of one that is in
it already."""
SAME_DATUM = 1e-3
"""Metres between two datums that are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    """The map of all sessions, what was mapped, and the seconds that those before took."""

    result: MapResult
    facts: InputFacts
    wall: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class EarlierMap:
    """A saved map that another session goes on with, and the origin of both."""

    run: SavedRun
    datum: Datum

    @property
    def settings(self) -> Tree:
        """What a session must have to lie in the same frame."""
        return {'datum': {'fixed': True, **asdict(self.datum)}}

    @property
    def windows(self) -> int:
        """How many windows are before those of a session that goes on."""
        return len(self.run.result.rows)

    def knows(self, result: MapResult) -> bool:
        """Whether a session knows where it is in the map before.

        Args:
            result: The session, mapped with ``settings``.
        """
        return result.statistics.georeferenced

    def map_of_both(self, result: MapResult, config: Config, facts: InputFacts) -> 'Whole':
        """The map of all sessions, once it is known how they lie to each other.

        Args:
            result: The session, mapped with ``settings``.
            config: All settings.
            facts: What it mapped.

        Returns:
            The map of both; the session alone, and that it is, where it is not known.
        """
        if not self.knows(result):
            return Whole(
                replace(result, findings=ranked([*result.findings, self.apart(True)])), facts
            )
        before = self.run.result
        if again := measured_twice((before, result)):
            told = ranked([*result.findings, self._repeated(again[-1])])
            return Whole(replace(result, findings=told), facts)
        counts = Counter(self.run.counts)
        counts.update(facts.counts)
        notes = (*facts.notes, f'goes on from {self.run.folder}')
        ties = find_ties(before, result, config)
        factors = tie_factors(ties, (0, len(before.clusters)), config.closure)
        seams = seam_factors(before, result, config)
        both = joined([before, alone(result, facts.path)], config, factors, ties.searched, seams)
        if ties.apart:
            found = disagreement(str(self.run.folder), facts.path, ties.apart)
            both = replace(both, findings=ranked([*both.findings, found]))
        return Whole(
            both,
            replace(facts, counts=counts, notes=notes),
            self.run.wall,
        )

    def _repeated(self, fixes: int) -> Finding:
        text = (
            f'{fixes} fixes of this session, at the same stamps and places, are in the map of '
            f'{self.run.folder} already: it is the same drive'
        )
        remedy = 'what is written is the session alone: twice the same tells nothing new'
        return Finding(REPEATED, Severity.ERROR, '', text, remedy)

    def apart(self, last: bool) -> Finding:
        """What tells that the session is a component of its own.

        Args:
            last: Whether nothing more will come of it.
        """
        text = (
            f'no fix has told yet where this session is in the map of {self.run.folder}: it is a '
            'component of its own'
        )
        if not last:
            return Finding(APART, Severity.WARNING, '', text, 'it is joined once fixes tell')
        remedy = 'this is the map of the session alone, in a frame of its own; see its fixes'
        return Finding(APART, Severity.ERROR, '', text.replace(' yet', ''), remedy)


def earlier_map(config: Config) -> EarlierMap | None:
    """The map that the settings want to be gone on with; None where a map begins.

    Args:
        config: All settings.

    Raises:
        ConfigError: They fix the origin of the map elsewhere.
        InputError: It cannot be gone on with.
    """
    folder = config.session.folder
    if folder is None:
        return None
    run = read_saved_run(folder, make_store(config.map))
    if run.datum is None:
        raise InputError(
            f'{folder}: its map is not east-north-up, since no fixes told where it is: another '
            'session cannot find its place in it'
        )
    if run.result.statistics.components != 1:
        raise InputError(
            f'{folder}: its map is in {run.result.statistics.components} pieces; it takes one that '
            'hangs together to go on'
        )
    wanted = fixed_datum(config.datum)
    if wanted is not None and np.linalg.norm(run.datum.enu_of(wanted)) > SAME_DATUM:
        raise ConfigError(
            f'datum: the settings fix {_told(wanted)}; the map in {folder}, in whose frame a '
            f'session goes on, has {_told(run.datum)}: leave the datum out, or begin another map'
        )
    return EarlierMap(run, run.datum)


def _told(datum: Datum) -> str:
    return f'{datum.latitude:.7f}, {datum.longitude:.7f}, {datum.altitude:.2f} m'


def whole(
    earlier: EarlierMap | None, result: MapResult, config: Config, facts: InputFacts
) -> Whole:
    """The map of all sessions, see ``EarlierMap.map_of_both``; of a map without one, itself.

    Args:
        earlier: The map that it goes on with, if any.
        result: The map of this session; it may be empty.
        config: All settings.
        facts: What it mapped.
    """
    if earlier is None or not result.clusters:
        return Whole(result, facts)
    return earlier.map_of_both(result, config, facts)


def whole_again(result: MapResult, config: Config, facts: InputFacts) -> Whole:
    """As ``whole`` long afterwards, as of a journal: the map before may be gone.

    Args:
        result: The map of a session.
        config: All settings of it, which name the map before.
        facts: What it mapped.
    """
    try:
        earlier = earlier_map(config)
    except MapperError as error:
        text = f'the map before cannot be read: {error}'
        remedy = 'this is the map of the last session alone, in the frame of all'
        lost = Finding('session_lost', Severity.WARNING, '', text, remedy)
        return Whole(replace(result, findings=ranked([*result.findings, lost])), facts)
    return whole(earlier, result, config, facts)
