"""Mapping anew where the data of a drive prove a setting wrong."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.fix_shape import without_consequences
from incremental_mapper.datasets.open import open_source
from incremental_mapper.garbage import search_all, set_aside
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.results.opened_drive import Drive, effective_config
from incremental_mapper.settings import merge

MOST_MENDS = 3
"""How often a run begins anew with settings that its data proved right."""


class Mapped(Protocol):
    """A run, as far as it is looked at here."""

    @property
    def result(self) -> MapResult:
        """What was mapped."""


AnyRun = TypeVar('AnyRun', bound=Mapped)


class MendError(Exception):
    """Ends a run whose data proved a setting wrong: it begins anew with those of ``findings``."""

    def __init__(self, findings: Sequence[Finding]) -> None:
        super().__init__('the data prove a setting wrong')
        self.findings = tuple(findings)


def mending(drive: Drive, attempt: Callable[[Drive, bool], AnyRun]) -> AnyRun:
    """Map a drive, and begin anew where the data prove a setting wrong."""
    begun, found = drive, list[Finding]()
    for _ in range(MOST_MENDS):
        try:
            run = attempt(drive, True)
        except MendError as mend:
            # With one LiDAR's pose in the settings the others are not looked for any more.
            left = [one for one in drive.source.info.findings if one.rule == 'lidar_left_out']
            found = [*without_consequences(found, mend.findings), *left, *mend.findings]
        else:
            better = _better_known(found, run.result.findings)
            if not better:
                return run
            found = [one for one in found if one.rule not in {new.rule for new in better}]
            found += better
        drive = _mended(begun, found)
        # The map so far hangs on the frames that raised: without this the next one comes on top.
        search_all()
        set_aside()
    return attempt(drive, False)


def _mended(begun: Drive, found: Sequence[Finding]) -> Drive:
    """A drive with what the data have proved."""
    tree = begun.tree
    for finding in found:
        tree = merge(tree, finding.settings if finding.changes else {})
    source = open_source(begun.source.info.path, tree)
    config = effective_config(source, tree, begun.where)
    return replace(begun, source=source, config=config, tree=tree, mended=(*begun.mended, *found))


def _better_known(before: Sequence[Finding], now: Sequence[Finding]) -> list[Finding]:
    """What a whole drive proposes for settings that went by its beginning: it is in force then."""
    early = {(one.rule, one.sensor) for one in before if one.changes}
    return [
        replace(one, in_force=True)
        for one in now
        if one.settings and not one.changes and (one.rule, one.sensor) in early
    ]
