"""A window that failed, as a file: all that its choice depends on, so that it can be chosen again.

``reselect_window`` runs the choice of such a file anew, and raises what it raised then. A file is
an ``.npz`` of plain arrays, one of which is a JSON text with the rest: nothing in it is executed.
"""

import io
import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.imu_preintegration import ImuSeries, preintegration_parameters
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.map.store import MemoryStore, StoredPoints
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.strategies import find_strategy
from incremental_mapper.selection.window_problem import WindowProblem, pose_problem
from incremental_mapper.settings import make_config, to_tree
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.variables import bias_key, kind_of, pose_key, velocity_key

FILE = 'failed_window_{}.npz'
"""Name of such a file, with the number of the window."""
FORMAT = 1
PACKAGE = 'incremental_mapper.'
RECENT_FIXES = 50
LEFT_OUT = (
    'store',
    'clusters',
    'factors',
    'scans',
    'components',
    'factor_counts',
    'inertial',
    'biased',
)
"""What of G(t-1) grows with the drive; no choice depends on it."""

Tree = Any


@dataclass(frozen=True, slots=True, eq=False)
class WindowRecord:
    """One failed window: its number, what it raised, and the bytes of its file."""

    window: int
    error: str
    data: bytes

    @property
    def name(self) -> str:
        """Name of its file."""
        return FILE.format(self.window)


def record_window(
    window: int,
    error: str,
    items: Sequence[Prepared],
    state: GraphState,
    series: ImuSeries,
    orientation: NDArray[np.float64] | None,
    config: Config,
    limit: int | None,
) -> WindowRecord:
    """Keep what a window's choice depends on.

    Args:
        window: Its number.
        error: What it raised, with the traceback.
        items: Its prepared core measurements.
        state: G(t-1).
        series: IMU samples that no span has used yet.
        orientation: The IMU's first quaternion, if it has any.
        config: All settings.
        limit: Candidates that might be solved; None is all.

    Returns:
        The record; points that only the map needs are not in it.
    """
    writer = _Writer()
    tree = {
        'format': FORMAT,
        'window': window,
        'error': error,
        'settings': to_tree(config),
        'items': writer.tree([_lighter(item) for item in items]),
        'state': writer.tree(_needed(state, config)),
        'series': writer.tree(series),
        'orientation': writer.tree(orientation),
        'limit': limit,
    }
    file = io.BytesIO()
    arrays: dict[str, Any] = {'text': np.array(json.dumps(tree)), **writer.arrays}
    np.savez_compressed(file, **arrays)
    return WindowRecord(window, error, file.getvalue())


def load_window(path: Path | str) -> WindowProblem:
    """The problem of a recorded window.

    Args:
        path: A ``failed_window_N.npz``.

    Returns:
        What its strategy was to select from.

    Raises:
        InputError: It is no such file, or of another version of this package.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        tree = json.loads(str(arrays['text']))
        if tree['format'] != FORMAT:
            raise ValueError(f'format {tree["format"]}, expected {FORMAT}')
        read = _Reader(arrays).value
        config = make_config(tree['settings'], str(path))
        items, state = read(tree['items']), GraphState(**read(tree['state']))
        series, orientation = read(tree['series']), read(tree['orientation'])
        limit = tree['limit']
    except (OSError, ValueError, KeyError, TypeError, BadZipFile, ConfigError) as error:
        raise InputError(f'{path}: is no record of a failed window ({error})') from error
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    return pose_problem(items, state, series, orientation, parameters, config, limit)


def reselect_window(path: Path | str) -> Choice:
    """Choose a recorded window's candidate again, as the run did in which it failed.

    Args:
        path: A ``failed_window_N.npz`` of a run's folder.

    Returns:
        The choice, where it fails no longer.

    Raises:
        InputError: It is no such file, or of another version of this package.
        Exception: Whatever the choice raises, as it did in the run.
    """
    problem = load_window(path)
    return find_strategy(problem.config.selection.strategy).select(problem)


def _lighter(item: Prepared) -> Prepared:
    """A measurement without the points that only the map needs."""
    if isinstance(item, PreparedScan):
        return replace(item, thinned=np.zeros((0, 3), np.float32))
    return item


def _needed(state: GraphState, config: Config) -> dict[str, Any]:
    """The fields of G(t-1) that a choice may depend on, cut to what it may look at."""
    made = {item.name: getattr(state, item.name) for item in fields(state)}
    for name in LEFT_OUT:
        del made[name]
    recent = list(state.recent)[-config.mom.submap_scans :]
    made['recent'] = deque(recent, maxlen=state.recent.maxlen)
    made['fixes'] = [*state.fixes[:1], *state.fixes[1:][-RECENT_FIXES:]]
    ids = {scan.cluster for scan, _ in recent}
    keys = set(state.frontier.keys())
    keys |= {make(id_) for id_ in ids for make in (pose_key, velocity_key, bias_key)}
    made['values'] = state.values.extract([key for key in keys if state.values.exists(key)])
    return made


@dataclass(slots=True)
class _Writer:
    """Makes trees for JSON of values; arrays go beside them under a name."""

    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)

    def tree(self, value: Any) -> Tree:
        if value is None or (isinstance(value, (bool, int, float, str)) and not _is_enum(value)):
            return value
        kind, content = self._kind(value)
        return {'is': kind, 'of': content}

    def _kind(self, value: Any) -> tuple[str, Tree]:
        if isinstance(value, Enum):
            return 'enum', [_name(value), value.value]
        if isinstance(value, np.generic):
            return 'number', value.item()
        if isinstance(value, np.ndarray):
            return 'array', self._array(value)
        if isinstance(value, gtsam.Pose3):
            return 'pose', self._array(value.matrix())
        if isinstance(value, gtsam.imuBias.ConstantBias):
            return 'bias', self._array(value.vector())
        if isinstance(value, gtsam.Values):
            return 'values', [[key, self._variable(value, key)] for key in value.keys()]  # noqa: SIM118
        if isinstance(value, Mapping):
            return 'dict', [[self.tree(key), self.tree(item)] for key, item in value.items()]
        if isinstance(value, deque):
            return 'deque', [value.maxlen, [self.tree(item) for item in value]]
        if isinstance(value, (list, tuple, set, frozenset)):
            return type(value).__name__, [self.tree(item) for item in value]
        if is_dataclass(value) and type(value).__module__.startswith(PACKAGE):
            if hasattr(value, 'load'):  # points of the map, which no choice looks at
                return 'points', None
            content = {item.name: self.tree(getattr(value, item.name)) for item in fields(value)}
            return 'record', [_name(value), content]
        raise TypeError(f'{type(value).__name__} cannot be recorded')

    def _array(self, value: NDArray[Any]) -> str:
        name = f'a{len(self.arrays)}'
        self.arrays[name] = np.asarray(value)
        return name

    def _variable(self, values: gtsam.Values, key: int) -> str:
        if kind_of(key) == 'x':
            return self._array(values.atPose3(key).matrix())
        if kind_of(key) == 'v':
            return self._array(values.atVector(key))
        return self._array(values.atConstantBias(key).vector())


@dataclass(frozen=True, slots=True)
class _Reader:
    """Makes values of what a writer made."""

    arrays: Mapping[str, NDArray[Any]]

    def value(self, tree: Tree) -> Any:
        return self._made(tree['is'], tree['of']) if isinstance(tree, dict) else tree

    def _made(self, kind: str, content: Tree) -> Any:
        simple: dict[str, Callable[[Tree], Any]] = {
            'number': lambda number: number,
            'array': lambda name: self.arrays[name],
            'pose': lambda name: gtsam.Pose3(self.arrays[name]),
            'bias': lambda name: _bias(self.arrays[name]),
            'values': self._values,
            'points': lambda _: _no_points(),
            'enum': lambda pair: _known(pair[0])(pair[1]),
            'dict': lambda pairs: {self.value(key): self.value(item) for key, item in pairs},
            'deque': lambda pair: deque(map(self.value, pair[1]), maxlen=pair[0]),
            'list': lambda items: [self.value(item) for item in items],
            'tuple': lambda items: tuple(self.value(item) for item in items),
            'set': lambda items: {self.value(item) for item in items},
            'frozenset': lambda items: frozenset(self.value(item) for item in items),
        }
        if kind == 'record':
            name, members = content
            return _known(name)(**{key: self.value(item) for key, item in members.items()})
        return simple[kind](content)

    def _values(self, pairs: Tree) -> gtsam.Values:
        values = gtsam.Values()
        for key, name in pairs:
            array = self.arrays[name]
            if kind_of(key) == 'x':
                values.insert(key, gtsam.Pose3(array))
            elif kind_of(key) == 'v':
                values.insert(key, array)
            else:
                values.insert(key, _bias(array))
        return values


def _is_enum(value: object) -> bool:
    return isinstance(value, Enum)


def _name(value: object) -> str:
    return f'{type(value).__module__}:{type(value).__qualname__}'


def _known(name: str) -> Any:
    """A data class or an enumeration of this package; nothing else is made from a file."""
    module, _, word = name.partition(':')
    if not module.startswith(PACKAGE):
        raise ValueError(f'{name} is none of this package')
    found = getattr(import_module(module), word)
    if not isinstance(found, type) or not (is_dataclass(found) or issubclass(found, Enum)):
        raise ValueError(f'{name} is no record')
    return found


def _bias(vector: NDArray[np.float64]) -> gtsam.imuBias.ConstantBias:
    return gtsam.imuBias.ConstantBias(vector[:3], vector[3:])


def _no_points() -> StoredPoints:
    return MemoryStore().put(np.zeros((0, 3), np.float32))
