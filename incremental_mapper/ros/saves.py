"""What is saved when, where to, and what is told of it."""

import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.config import SaveSettings
from incremental_mapper.ros.inbox import Command
from incremental_mapper.ros.save_process import MOST, Job, Outcome, SaveProcesses, run_here
from incremental_mapper.ros.saving import (
    EMPTY,
    Saved,
    Snapshot,
    Target,
    save_map,
    windows_before,
    write_candidates,
)
from incremental_mapper.ros.updates import Reply, Trouble, Update

PICTURES = 10.0
"""Seconds for which the end of the node waits for pictures; they are made without it, too, unless
whatever the node runs in ends with it."""
COMPARED = 10
"""Pairs of places that a save of a map that goes on compares at the most, some seconds of a
processor: what is left, the search beside the windows looks at, and the save at the end."""
BUSY = 'two maps are being saved already; call again when they are'


class Saves:
    """All saving of a worker, in whose thread every method is called unless it says otherwise."""

    def __init__(
        self, emit: Callable[[Update], None], settings: Callable[[], SaveSettings]
    ) -> None:
        """Be ready.

        Args:
            emit: Takes what is told; called by any thread.
            settings: Tells where to save, at each time.
        """
        self.failed = 0
        """Maps that were to be saved and are not where, or as, they should be."""
        self.hurry = threading.Event()
        """Set by any thread: nobody has the time to wait for pictures."""
        self._emit = emit
        self._settings = settings
        self._processes = SaveProcesses(lambda remark: emit(Trouble(remark)))

    def asked(self, command: Command, snapshot: Snapshot) -> None:
        """Save because somebody called for it; the reply comes when the data are in place."""
        if self._processes.saving >= MOST:
            self._emit(Reply(command.ticket, False, BUSY))
            return

        def done(outcome: Outcome) -> None:
            self._tell_fault(outcome)
            success, message = told(outcome, settings.pictures)
            self._emit(Reply(command.ticket, success, message))

        settings = self._settings()
        bounded = replace(snapshot, most=COMPARED)
        job = _job(bounded, self._target(settings.folder), settings.pictures)
        self._processes.start(job, done)

    def ends(self, snapshot: Snapshot, last: bool = False) -> None:
        """Save a map that ends, if that is wanted.

        Args:
            snapshot: The map.
            last: Whether the node ends too; it then waits until the data are in place.
        """
        folder = self._settings().on_shutdown
        if not folder:
            return
        job = _job(snapshot, self._target(folder), self._settings().pictures, quiet=not last)

        def ended(outcome: Outcome) -> None:
            # What lies elsewhere, or not whole, leaves the journal a use.
            if snapshot.journal is not None and outcome.saved and not outcome.saved.trouble:
                snapshot.journal.remove()
            self._ended(outcome)

        outcomes: list[Outcome] = []
        self._processes.start(job, outcomes.append if last else ended)
        if not last:
            return
        self._processes.wait()
        (outcome,) = outcomes
        ended(run_here(job.save) if outcome.died else outcome)

    def nothing(self) -> None:
        """Tell that there is no map to be saved at the end, if one is wanted."""
        if self._settings().on_shutdown:
            self._ended(Outcome(None, EMPTY))

    def finish(self) -> None:
        """Wait until all data are in place, and a while for pictures."""
        self._processes.wait()
        end = time.monotonic() + PICTURES
        while not (self._processes.wait_for_pictures(0.1) or self.hurry.is_set()):
            if time.monotonic() > end:
                return

    def _ended(self, outcome: Outcome) -> None:
        """Tell of a map that ended; called by any thread."""
        self._tell_fault(outcome)
        success, message = told(outcome, self._settings().pictures)
        self.failed += not success
        self._emit(Trouble(message))

    def _tell_fault(self, outcome: Outcome) -> None:
        if outcome.fault:
            self._emit(Trouble(f'saving failed:\n{outcome.fault}'))

    def _target(self, folder: str) -> Target:
        fallback = self._settings().fallback
        return Target(Path(folder), Path(fallback or tempfile.gettempdir()).expanduser())


def told(outcome: Outcome, pictures: bool) -> tuple[bool, str]:
    """Whether a map is saved as it was wanted and is to be trusted, and the words for it."""
    saved = outcome.saved
    if saved is None:
        return False, outcome.reason
    worst = [item for item in saved.warnings if item.severity is not Severity.MENDED][:1]
    failed = bool(saved.trouble) or any(item.severity is Severity.ERROR for item in worst)
    remarks = _remarks(saved, worst) or ('; pictures follow' if pictures else '')
    return not failed, f'saved to {saved.folder}{remarks}'


def _remarks(saved: Saved, worst: list[Finding]) -> str:
    remarks = [saved.trouble] if saved.trouble else []
    remarks += [finding.titled() for finding in worst]
    return ''.join(f'; {remark}' for remark in remarks)


def _job(snapshot: Snapshot, target: Target, pictures: bool, quiet: bool = True) -> Job:
    spool = snapshot.spool

    def more(folder: Path) -> str | None:
        return None if spool is None else write_candidates(folder, spool, windows_before(folder))

    return Job(lambda: save_map(target, snapshot), more, pictures, quiet)
