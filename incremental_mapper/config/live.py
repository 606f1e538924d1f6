"""Settings of the node and of what is kept of its maps."""

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import AfterValidator, Field

from incremental_mapper.config.sections import Section


class PathSettings(Section):
    """Node: the published trajectory."""

    max_poses: int = Field(default=2000, ge=10, le=100_000)
    """A longer trajectory is thinned to at most so many poses."""
    publish_period: float = Field(default=1.0, ge=0.05, le=3600.0)
    """Shortest time between two publications of the path, in seconds."""


class FrameSettings(Section):
    """Node: names of the frames (REP-105)."""

    map: str = Field(default='map', min_length=1)
    """Frame of poses, path, map and graph; local ENU once georeferenced."""
    odom: str = Field(default='odom', min_length=1)
    """Frame in which the car moves without jumps."""
    base: str = Field(default='base_link', min_length=1)
    """The car's own frame."""


class TfMode(StrEnum):
    """What is broadcast on /tf."""

    BOTH = 'both'
    MAP_TO_ODOM = 'map_to_odom'
    NONE = 'none'


class TfSettings(Section):
    """Node: what it tells others of its frames, where tf2_msgs is installed."""

    publish: TfMode = TfMode.BOTH
    """both broadcasts map to odom and odom to base; map_to_odom only the first, held against the
    robot's own odom to base as it is heard on /tf; none neither."""
    sensors: bool = True
    """Publish T_base_sensor of the settings on /tf_static where nobody else tells it."""
    ahead: float = Field(default=0.0, ge=0.0, le=10.0)
    """Seconds by which map to odom is dated into the future, for those who ask for the map now."""


class ImuOdometrySettings(Section):
    """Node: ~/odometry_imu, where the car is between two windows by the IMU."""

    publish: bool = False
    """Publish it."""
    max_rate: float = Field(default=200.0, gt=0.0, le=2000.0)
    """Most messages a second, Hz; a faster IMU is still integrated in full."""
    max_age: float = Field(default=1.0, gt=0.0, le=10.0)
    """Seconds after the last window's newest state for which it is carried on."""


LONGEST_NAME = 200
"""Bytes of a folder's name: file systems take 255, and a number or a word is put behind it."""


def _folder_name(text: str) -> str:
    """A folder that can be made: it needs a name of its own."""
    if text and ('\0' in text or Path(text).name in ('', '..')):
        raise ValueError(f'{text!r} names no folder that could be made')
    longest = max((len(os.fsencode(part)) for part in Path(text).parts), default=0)
    if longest > LONGEST_NAME:
        raise ValueError(f'a name in it has {longest} bytes; {LONGEST_NAME} are the most')
    return text


FolderName: TypeAlias = Annotated[str, AfterValidator(_folder_name)]


class SaveSettings(Section):
    """Node: where maps are saved. A number is added to a name that is taken."""

    folder: FolderName = Field(default='incremental_map', min_length=1)
    """Folder that the service save_map writes."""
    on_shutdown: FolderName = ''
    """Folder to save into at shutdown, and before a new map begins because of a time jump or of
    a sensor whose place is told late; empty saves not."""
    every: float = Field(default=0.0, ge=0.0, le=86400.0)
    """Seconds of the map that a power cut may cost at the most: a journal (see ``journal``) is
    flushed to the disk so often. Where ``journal.folder`` is empty it lies in a folder named as
    ``folder`` with _autosave. 0: only ``journal`` says whether there is one."""
    fallback: str = ''
    """Folder that takes a map whose own place cannot be written; empty takes the system's folder
    for temporary files."""
    pictures: bool = True
    """Draw pictures once the data are in place, where matplotlib is installed: some seconds of
    another process."""
    candidates: bool = True
    """Write candidates.parquet too, where pyarrow is installed; keeps every candidate in a
    temporary file, about 50 MB an hour."""


class JournalSettings(Section):
    """What is written of a map while it is made, so that no crash and no power cut loses it."""

    folder: FolderName = ''
    """Folder of the journals: each map has one, which is removed once the map is saved. 4 to 13 GB
    an hour with two VLP-16, in place of what ``map.store`` would take. Empty: none is written,
    unless ``save.every`` asks for one."""
    sync: float = Field(default=1.0, ge=0.0, le=86400.0)
    """Seconds between two flushes to the disk: what a power cut may cost. A program that is killed
    loses no more than a window, whatever this is."""
    reserve: float = Field(default=500.0, ge=0.0, le=1e9, allow_inf_nan=False)
    """MB of the disk that are free when the journal ends, so that the map has room to be saved."""
    recover: bool = True
    """Node: at the start, make maps of the journals that are left over in the folder, beside
    the mapping, and remove them."""


class SessionSettings(Section):
    """A map that is gone on with."""

    # A word of Python's cannot be written as a field, but it is the right name for users.
    __annotations__ = {'continue': FolderName}
    vars()['continue'] = Field(
        default='',
        description='Folder of a finished run, or of a map that was saved, to go on with, in its '
        'frame and around its datum; what is saved is the map of all sessions. Empty begins anew.',
    )

    @property
    def folder(self) -> Path | None:
        """The folder to go on with, None where a map begins."""
        name: str = getattr(self, 'continue')
        return Path(name).expanduser().absolute() if name else None


class TimeJumpPolicy(StrEnum):
    """What follows when stamps jump backwards, as in a looped bag."""

    RESET = 'reset'
    IGNORE = 'ignore'


class TimeJumpSettings(Section):
    """Node: stamps that jump backwards."""

    threshold: float = Field(default=1.0, gt=0.0, le=3600.0)
    """A sensor's stamp that is so many seconds older than its newest one is a jump."""
    policy: TimeJumpPolicy = TimeJumpPolicy.RESET
    """reset starts a new map, ignore counts such measurements and leaves them out."""


class QueueSettings(Section):
    """Node: measurements that wait for the worker.

    From a fifth of ``core`` or of ``max_delay`` on fewer candidates are solved, from half of it on
    windows are merged; when the queue is full the oldest measurement is dropped and counted.
    """

    core: int = Field(default=300, ge=10, le=100_000)
    """Scans and fixes that may wait."""
    imu: int = Field(default=20_000, ge=100, le=1_000_000)
    """IMU samples that may wait."""
    max_delay: float = Field(default=1.0, ge=0.0, le=600.0)
    """Seconds that measurements may wait while others come. From four fifths of it on scans are
    left out that newer ones of their LiDAR stand behind, and counted as ``overload``. 0: whatever
    the delay none is, for bags that are played faster than they are mapped."""
    shutdown_timeout: float = Field(default=10.0, ge=0.0, le=600.0)
    """Seconds that shutdown may take to map what waits; saving comes on top."""


class DiagnosticsSettings(Section):
    """Node: the topic /diagnostics."""

    period: float = Field(default=1.0, ge=0.1, le=60.0)
    """Seconds between two messages."""
