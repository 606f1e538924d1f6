"""Finite values that no sensor measures: they cost at most the window that they fall into."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fuzz import run_map, write_bag
from lies.hostile import Sent, as_data
from lies.recording import DRIVES, IMU, LIDARS, Recording, make_drive, vector

from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.trajectory import read_tum
from robot_rows import Seen, row

WORSE = 1.1
"""Times the error of the run without them."""
AT = 400
"""The sample of the IMU, of some 700, at which they begin."""
SEEDS = (11, 14, 15, 16)
"""Of the drives in which the IMU is knocked; in the last three a map was bent by 0.3 to 5 m."""


def with_rate(value: float) -> Callable[[Any], Any]:
    """Make a sample turn by so many rad/s."""
    return lambda sample: replace(sample, angular_velocity=vector([0.0, 0.0, value]))


def with_force(value: float) -> Callable[[Any], Any]:
    """Make a sample accelerate by so many m/s^2."""
    return lambda sample: replace(sample, linear_acceleration=vector([value, 0.0, 9.81]))


def left_out(sample: Any) -> None:
    """Never sent."""


def error(recording: Recording, folder: Path, spoil: Callable[[Any], Any], count: int) -> float:
    """ATE in metres where ``count`` samples are spoilt; infinite without a map."""
    sent, number = [], 0
    for logged, topic, message in recording.items:
        number += topic == IMU
        spoilt = topic == IMU and AT <= number < AT + count
        message = spoil(message) if spoilt else message
        if message is not None:
            sent.append(Sent(logged, topic, '', as_data(message)))
    name = f'bag_{len(list(folder.iterdir()))}'
    result = run_map(write_bag(sent, recording, folder / name), folder / f'map_of_{name}')
    path = result.folder / 'trajectory.tum'
    if result.status or not path.exists():
        return float('inf')
    errors = trajectory_errors(read_tum(path), read_truth(recording.folder / 'global_pose.csv'))
    return float('inf') if errors is None else errors.ate_rmse_m


def held(folder: Path, spoils: dict[str, tuple[Callable[[Any], Any], int]]) -> Seen:
    """Map a drive of 7 s alone and with each kind of spoilt samples."""
    kind = replace(DRIVES['curve'], seconds=7.0)
    recording = make_drive(kind, folder / 'drive')
    alone = error(recording, folder, lambda sample: sample, 0)
    found = {
        name: error(recording, folder, spoil, count) for name, (spoil, count) in spoils.items()
    }
    listed = ', '.join(f'{name}: {value:.4f} m' for name, value in found.items())
    good = all(value <= WORSE * alone for value in found.values())
    return Seen(f'ATE alone {alone:.4f} m; {listed}', good)


@row('the map ends 117 m or 500 m off and never recovers')
def one_rate(folder: Path) -> Seen:
    """One gyro sample of 1000, 100 or 30 rad/s in a 7 s drive."""
    return held(folder, {f'{v:g} rad/s': (with_rate(v), 1) for v in (1000.0, 100.0, 30.0)})


@row('the map ends 117 m or 500 m off and never recovers')
def one_force(folder: Path) -> Seen:
    """One acceleration of 1e300, 1e5, 500 or 200 m/s^2 in a 7 s drive."""
    values = (1e300, 1e5, 500.0, 200.0)
    return held(folder, {f'{v:g} m/s^2': (with_force(v), 1) for v in values})


@row('the map bends, by metres in four drives of eight')
def knocked(folder: Path) -> Seen:
    """0.2 s of an IMU that is knocked, and that is silent instead, in four drives of 7 s."""
    return knocked_in(folder, lambda drive: drive, (20.0, 5.0))


@row('the run ends with an error, or the map is bent by 0.1 m')
def knocked_unseen(folder: Path) -> Seen:
    """The same while both LiDARs are silent, for 0.3 s before it and until 0.3 s behind it."""
    # 5 rad/s may be a hand's, and nothing contradicts them there: such runs end with an error.
    return knocked_in(folder, without_clouds, (20.0,))


def without_clouds(drive: Recording) -> Recording:
    """No cloud comes while the IMU is knocked."""
    at = [logged for logged, topic, _ in drive.items if topic == IMU][AT - 1]
    low, high = at - round(0.3 * NANOSECONDS), at + round(0.5 * NANOSECONDS)
    items = (item for item in drive.items if item[1] not in LIDARS or not low <= item[0] <= high)
    return replace(drive, items=tuple(items))


def knocked_in(
    folder: Path, changed: Callable[[Recording], Recording], rates: Sequence[float]
) -> Seen:
    """Four drives, each with every knock; ``rates`` are those of the gyroscope, rad/s."""
    count = 20
    spoils: dict[str, Callable[[Any], Any]] = {
        'silent': left_out,
        **{f'{value:g} rad/s': with_rate(value) for value in rates},
        **{f'{value:g} m/s^2': with_force(value) for value in (100.0, 45.0)},
    }
    found: dict[str, list[float]] = {name: [] for name in ('alone', *spoils)}
    for seed in SEEDS:
        below = folder / str(seed)
        kind = replace(DRIVES['curve'], seconds=7.0)
        drive = changed(make_drive(kind, below / 'drive', seed=seed))
        found['alone'].append(error(drive, below, lambda sample: sample, 0))
        for name, spoil in spoils.items():
            found[name].append(error(drive, below, spoil, count))
    # What the samples would have said is lost either way.
    good = all(
        value <= WORSE * silent
        for name in spoils
        for value, silent in zip(found[name], found['silent'], strict=True)
    )
    listed = ', '.join(
        f'{name} {" ".join(f"{value:.4f}" for value in values)}' for name, values in found.items()
    )
    return Seen(f'ATE in m: {listed}', good)


@row('the node ended 3 times of 3 (LinAlgError in outputs.py)', long=True)
def fuzz(folder: Path) -> Seen:
    """20 000 hostile messages with absurd values and stray stamps into the node, five seeds."""
    program = Path(__file__).parents[1] / 'fuzz.py'
    words = ['--only', 'node', '--seeds', '1,2,3,4,5', '--out', str(folder)]
    done = subprocess.run(
        [sys.executable, str(program), *words], capture_output=True, text=True, check=False
    )
    rows = [line for line in done.stdout.splitlines() if line.startswith('| node | ')]
    listed = '; '.join(' '.join(line.strip('| ').split()) for line in rows)
    return Seen(f'seed, status, metres apart, MB: {listed}', done.returncode == 0)
