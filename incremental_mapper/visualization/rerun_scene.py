"""A run in Rerun: what is seen of it, from plain values, whoever has them.

One time line has the stamps of the windows, another their numbers. What is added up (points of the
map, fixes) is logged once and shown for all time before the cursor; the rest is logged as it is.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.visualization.factor_colours import (
    CLUSTER_COLOUR,
    FACTOR_COLOURS,
    POSE_COLOUR,
    PRIOR_COLOUR,
)
from incremental_mapper.visualization.shown_candidates import ShownCandidate, table_text

INSTALL = 'pip install "incremental_mapper[view]"'
APPLICATION = 'incremental_mapper'
STAMP, WINDOW = 'stamp', 'window'
"""Names of the time lines."""
POINTS, FIXES, CAR, PATH = 'map/points', 'map/fixes', 'map/car', 'map/path'
GRAPH, NUMBERS, CANDIDATES = 'map/graph', 'numbers', 'candidates'
SCORES = f'{NUMBERS}/score'
WHOLE_GRAPH = 'map/whole_graph'
_PARTS = ('poses', 'clusters', 'priors', *FACTOR_COLOURS)
_ADDED_UP = (f'{POINTS}/0', f'{POINTS}/1', FIXES, *(f'{WHOLE_GRAPH}/{part}' for part in _PARTS))
WAY_COLOUR = (235, 60, 60)
POINT, LINE, WAY, POSE = 0.8, 0.8, 2.2, 1.3
"""Radii on the screen, in its points: walls of thick points would hide the street between them, and
a way a hand wide is not seen from where the whole drive is."""
_FROM = np.array([0.0, -0.5, 0.85])
"""Direction from the map to the eye."""
_NEAREST = 60.0
"""Metres from which the eye looks at least, when a car hardly moves."""
_SIGMAS = 3.0
"""Half axes of a fix's ellipsoid are so many standard deviations."""
_LOW, _HIGH = -3.0, 12.0
"""Heights above base_link, metres, between which the colours of points run: the road is light, so
that way and graph are seen on it."""
_RAMP = np.array([[200, 205, 212], [150, 172, 190], [70, 140, 160], [225, 180, 70], [225, 95, 60]])
Eye: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Where it is and what it looks at, (3,) each, metres."""


class RerunScene:
    """Logs a run into one recording; every method logs at the time that ``at`` has set."""

    def __init__(self, save: Path | None, spawn: bool = True, candidates: bool = True) -> None:
        """Begin a recording.

        Args:
            save: The file that it is written to; None keeps none.
            spawn: Open a viewer and stream into it, where nothing is saved.
            candidates: Have room for those of each window.

        Raises:
            InputError: Rerun is not installed, or its viewer does not start.
            OutputError: The file cannot be written.
        """
        self._rr = load_rerun()
        self._save, self._spawn, self._candidates = save, spawn, candidates
        self._maps = 0
        self._begin(save)

    def begin_again(self) -> None:
        """Begin another recording, which shows nothing of the map so far: that is no more.

        A range of time, by which points add up, does not end where something is cleared, and the
        stamps of the next map may lie before those of this one. The viewer has both among its
        recordings; a file's name gets a number.

        Raises:
            InputError: The viewer does not start.
            OutputError: The file cannot be written.
        """
        self.close()
        save = self._save
        self._begin(None if save is None else save.with_stem(f'{save.stem}_{self._maps + 1}'))

    def _begin(self, save: Path | None) -> None:
        rr = self._rr
        self._maps += 1
        self._turns = 0
        self._filled: set[str] = set()  # parts of the graph that show something
        self._stream = rr.RecordingStream(APPLICATION)
        blueprint = _blueprint(self._candidates)
        if save is not None:
            try:
                self._stream.save(save, default_blueprint=blueprint)
            except (OSError, RuntimeError) as error:
                raise OutputError(f'{save}: cannot be written ({error})') from error
        elif self._spawn:
            try:
                # Where one is open already, Rerun streams into that.
                self._stream.spawn(default_blueprint=blueprint)
            except RuntimeError as error:
                raise InputError(f'the viewer of Rerun does not start ({error})') from error
        self._log('map', rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log(CAR, rr.TransformAxes3D(2.0), static=True)
        lines = rr.SeriesLines(
            names=['winner', 'lowest', 'median'],
            colors=[(235, 60, 60), (80, 140, 235), (150, 150, 150)],
            widths=[2.5, 1.0, 1.0],
        )
        self._log(SCORES, lines, static=True)

    def overlook(self, positions: NDArray[np.float64]) -> None:
        """Let the eye look down on all of a way, over the roofs into the streets.

        Args:
            positions: Of the whole run (N, 3), metres.
        """
        low, high = positions.min(axis=0), positions.max(axis=0)
        distance = max(1.25 * float(np.linalg.norm(high - low)), _NEAREST)
        middle = 0.5 * (low + high)
        layout = _blueprint(eye=(middle + distance * _FROM, middle))
        self._stream.send_blueprint(layout, make_active=False)

    def at(self, stamp: int, window: int) -> None:
        """Set the time.

        Args:
            stamp: Nanoseconds.
            window: Number of the window.
        """
        self._stream.set_time(STAMP, timestamp=np.datetime64(stamp, 'ns'))
        self._stream.set_time(WINDOW, sequence=window)

    def points(self, points: NDArray[np.floating], height: float) -> None:
        """Add points (N, 3 or more) to the map, metres; ``height`` is that of base_link there."""
        positions = points[:, :3].astype(np.float32)
        colours = _packed(_colours(positions[:, 2] - height))
        radius = self._rr.Radius.ui_points(POINT)
        shown = self._rr.Points3D(positions, colors=colours, radii=radius)
        self._log(f'{POINTS}/{self._turns}', shown)

    def turned(self, T_new_old: NDArray[np.float64]) -> None:
        """Lay all points so far elsewhere: the map became east, north, up, once in a run.

        Args:
            T_new_old: (4, 4), from the frame that they were logged in.
        """
        transform = self._rr.Transform3D(translation=T_new_old[:3, 3], mat3x3=T_new_old[:3, :3])
        self._log(f'{POINTS}/{self._turns}', transform)
        self._turns = min(self._turns + 1, 1)

    def car(self, T_map_base: NDArray[np.float64]) -> None:
        """Set where the car is, (4, 4)."""
        self._log(
            CAR, self._rr.Transform3D(translation=T_map_base[:3, 3], mat3x3=T_map_base[:3, :3])
        )

    def path(self, positions: NDArray[np.float64]) -> None:
        """Show the way (N, 3), metres, in place of the one before."""
        radius = self._rr.Radius.ui_points(WAY)
        self._log(PATH, self._rr.LineStrips3D([positions], colors=[WAY_COLOUR], radii=radius))

    def graph(
        self,
        poses: NDArray[np.float64],
        merged: NDArray[np.float64],
        edges: Mapping[str, NDArray[np.float64]],
        priors: NDArray[np.float64],
        add: bool = False,
    ) -> None:
        """Show a part of the graph in place of the one before.

        Args:
            poses: (N, 3), metres.
            merged: Those of them (M, 3) whose clusters hold several measurements.
            edges: Ends (E, 2, 3) of factors by their kind.
            priors: (P, 3).
            add: Add it to those before instead.
        """
        rr, place = self._rr, WHOLE_GRAPH if add else GRAPH
        radius = rr.Radius.ui_points(POSE)
        shown = rr.Points3D(poses, colors=[_bytes(POSE_COLOUR)], radii=radius)
        self._part(f'{place}/poses', len(poses), shown)
        boxes = rr.Boxes3D(
            centers=merged, half_sizes=[(0.35, 0.35, 0.25)], colors=[_bytes(CLUSTER_COLOUR)]
        )
        self._part(f'{place}/clusters', len(merged), boxes)
        priors_shown = rr.Points3D(priors, colors=[_bytes(PRIOR_COLOUR)], radii=[0.3])
        self._part(f'{place}/priors', len(priors), priors_shown)
        for kind in FACTOR_COLOURS:
            ends = edges.get(kind, np.zeros((0, 2, 3)))
            if len(ends) or f'{place}/{kind}' in self._filled:
                lines = rr.LineStrips3D(
                    ends, colors=[_bytes(FACTOR_COLOURS[kind])], radii=rr.Radius.ui_points(LINE)
                )
                self._part(f'{place}/{kind}', len(ends), lines)

    def _part(self, place: str, count: int, what: Any) -> None:
        """Show a part of the graph; what was empty and still is costs the mapping nothing."""
        if count or place in self._filled:
            self._log(place, what)
        (self._filled.add if count else self._filled.discard)(place)

    def fixes(self, positions: NDArray[np.float64], covariances: NDArray[np.float64]) -> None:
        """Add fixes with their ellipsoids of three standard deviations.

        Args:
            positions: Of the antenna (K, 3), metres in the map.
            covariances: (K, 3, 3), m^2, along the axes of the map.
        """
        variances, axes = np.linalg.eigh(covariances)
        axes[np.linalg.det(axes) < 0.0, :, 0] *= -1.0  # eigenvectors may be mirrored
        self._log(
            FIXES,
            self._rr.Ellipsoids3D(
                centers=positions,
                half_sizes=_SIGMAS * np.sqrt(np.maximum(variances, 0.0)),
                quaternions=[_quaternion(turn) for turn in axes],
                colors=[_bytes(FACTOR_COLOURS['gnss'])],
            ),
        )

    def candidates(self, candidates: Sequence[ShownCandidate], score_name: str) -> None:
        """Show what a window chose from, and add its scores to their time line.

        Args:
            candidates: Those that were looked at.
            score_name: What the scores are.
        """
        rr = self._rr
        ranked = sorted(
            candidates, key=lambda item: np.inf if item.score is None else float(item.score)
        )
        scores = np.array([item.score for item in ranked if item.score is not None])
        winner = next((item.score for item in ranked if item.winner), None)
        if len(scores):
            three = [np.nan if winner is None else winner, scores[0], float(np.median(scores))]
            self._log(SCORES, rr.Scalars(three))
        text = table_text(ranked, score_name)
        self._log(f'{CANDIDATES}/table', rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def winner_score(self, score: float) -> None:
        """Add the score of a winner to its time line where the others' are not known."""
        self._log(SCORES, self._rr.Scalars([score]))

    def numbers(self, numbers: Mapping[str, float]) -> None:
        """Add numbers to their time lines, by name."""
        for name, value in numbers.items():
            self._log(f'{NUMBERS}/{name}', self._rr.Scalars(value))

    def close(self) -> None:
        """Write or send what waits."""
        self._stream.flush()
        self._stream.disconnect()

    def _log(self, place: str, what: Any, static: bool = False) -> None:
        self._stream.log(place, what, static=static)


def load_rerun() -> Any:
    """The library.

    Raises:
        InputError: It is not installed.
    """
    try:
        import rerun
        import rerun.blueprint
    except ImportError as error:
        raise InputError(
            f'rerun-sdk is missing, which shows runs; install it with: {INSTALL}'
        ) from error
    return rerun


def check_rrd(path: Path) -> None:
    """Tell early where a file cannot be one of Rerun.

    Args:
        path: The file that a user names.

    Raises:
        OutputError: It has another suffix, or no folder to lie in.
    """
    if path.suffix != '.rrd':
        raise OutputError(f'{path}: Rerun knows its files by their suffix; name one with .rrd')
    if not path.absolute().parent.is_dir():
        raise OutputError(f'{path}: cannot be written (no such folder)')


def _blueprint(candidates: bool = True, eye: Eye | None = None) -> Any:
    """How the viewer is laid out at first; without an eye Rerun looks at all there is so far."""
    import rerun.blueprint as rrb

    until_now = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                line,
                start=rrb.TimeRangeBoundary.infinite(),
                end=rrb.TimeRangeBoundary.cursor_relative(),
            )
            for line in (STAMP, WINDOW)
        ]
    )
    scene = rrb.Spatial3DView(
        origin='map',
        name='map',
        background=[245, 245, 245],
        eye_controls=None
        if eye is None
        else rrb.EyeControls3D(position=eye[0], look_target=eye[1]),
        overrides={place: until_now for place in _ADDED_UP},
    )
    scores = rrb.TimeSeriesView(origin=SCORES, name='score of each window')
    table = rrb.TextDocumentView(origin=f'{CANDIDATES}/table', name="this window's best candidates")
    numbers = rrb.TimeSeriesView(
        origin=NUMBERS, contents=_other_numbers(), name='candidates, solver error'
    )
    panels = (scores, table, numbers) if candidates else (scores, numbers)
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Vertical(*panels), column_shares=[3, 2]),
        rrb.TimePanel(timeline=STAMP, state='collapsed', play_state='following'),
        collapse_panels=True,
    )


def _other_numbers() -> list[str]:
    return [f'+ /{NUMBERS}/**', f'- /{SCORES}/**']


def _colours(heights: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colours (N, 3) of heights above the car, metres."""
    share = np.clip((heights - _LOW) / (_HIGH - _LOW), 0.0, 1.0) * (len(_RAMP) - 1)
    stops = np.arange(len(_RAMP))
    channels = [np.interp(share, stops, _RAMP[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=1).astype(np.uint8)


def _packed(colours: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Opaque colours (N, 3) as Rerun keeps them, 0xRRGGBBAA: it takes three times as long to."""
    red, green, blue = colours.T.astype(np.uint32)
    packed: NDArray[np.uint32] = red << 24 | green << 16 | blue << 8 | 255
    return packed


def _bytes(colour: tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue


def _quaternion(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """A rotation (3, 3) as x, y, z, w."""
    from scipy.spatial.transform import Rotation

    numbers: NDArray[np.float64] = Rotation.from_matrix(turn).as_quat()
    return numbers
