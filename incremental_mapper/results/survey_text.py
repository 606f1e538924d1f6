"""A survey as text: one table of all sensors, then a line or two on each."""

from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np

from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.datasets.sampling import SensorKind, SensorSample
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import NANOSECONDS, GnssFix, ImuSample
from incremental_mapper.results.lidar_shape import LidarShape
from incremental_mapper.results.survey import Survey

_HOUR, _YEAR = 3600.0, 365.25 * 86400.0
_AXES = ('x', 'y', 'z')
_NEVER = '-'


def survey_text(survey: Survey) -> str:
    """Write down what a look shows, without its findings.

    Args:
        survey: the look.

    Returns:
        Lines without a trailing newline; the columns of the table are aligned.
    """
    lines = [_headline(survey), '', *_aligned(_table(survey)), '']
    details = [*_details(survey), ('truth', survey.truth or 'none'), *_start(survey)]
    details += [('note', note) for note in survey.info.notes]
    width = max(len(name) for name, _ in details)
    return '\n'.join([*lines, *(f'{name:<{width}}  {text}' for name, text in details)])


def _headline(survey: Survey) -> str:
    info = survey.info
    starts = [int(s.received.min()) for s in survey.samples if len(s.received)]
    since = ''
    if starts:
        try:
            moment = datetime.fromtimestamp(min(starts) / NANOSECONDS, UTC)
            since = f' from {moment:%Y-%m-%d %H:%M:%S} UTC'
        except (OverflowError, ValueError, OSError):
            since = f' from {min(starts) / NANOSECONDS:.3f} s'
    return f'{info.path}: {info.kind}, {info.duration:.1f} s{since}'


def _table(survey: Survey) -> list[list[str]]:
    """Rows of the table; the first has the titles. Columns that say nothing are left out."""
    titles = ['sensor', 'topic', 'messages', 'rate', 'longest gap', 'stamp - record', 'frame']
    rows = [[*titles, 'T_base_sensor from']]
    for sample in survey.samples:
        offset = survey.sensor(sample.sensor).time_offset
        times = [rate_text(sample), _gap(sample), clock_text(sample, offset)]
        facts = [sample.sensor, sample.topic, str(sample.count)]
        rows.append([*facts, *times, sample.frame, sample.origin])
    kept = [column for column in zip(*rows, strict=True) if any(column[1:])]
    return [list(row) for row in zip(*kept, strict=True)]


def rate_text(sample: SensorSample) -> str:
    """Messages a second where they come."""
    return f'{sample.rate:.3g} Hz' if sample.rate else _NEVER


def _gap(sample: SensorSample) -> str:
    """Longest time without a message, where the times of all are known."""
    return f'{sample.steps.max():.3g} s' if len(sample.recorded) > 1 else _NEVER


def clock_text(sample: SensorSample, offset: float = 0.0) -> str:
    """Median of stamp minus time of recording, and how far it varies; empty where there is none.

    Args:
        sample: of the sensor.
        offset: seconds that were added to its stamps; both clocks are shown.
    """
    if not sample.logged or not len(sample.stamps):
        return ''
    ahead = (sample.stamps - sample.received) / NANOSECONDS
    middle = float(np.median(ahead))
    spread = float(np.quantile(np.abs(ahead - middle), 0.95))
    shown = _seconds(middle) + (f' ± {spread:.3f}' if spread >= 0.0005 else '')
    return f'{_seconds(middle - offset)} -> {shown}' if offset else shown


def _seconds(value: float) -> str:
    if abs(value) > _YEAR:
        return f'{value / _YEAR:+.2f} years'
    return f'{value:+.0f} s' if abs(value) > _HOUR else f'{value:+.3f} s'


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as lines: numbers to the right, words to the left."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    right = {'messages', 'rate', 'longest gap', 'stamp - record'}
    lines = []
    for row in rows:
        cells = [
            cell.rjust(width) if title in right else cell.ljust(width)
            for cell, width, title in zip(row, widths, rows[0], strict=True)
        ]
        lines.append('  '.join(cells).rstrip())
    return lines


def _details(survey: Survey) -> Iterator[tuple[str, str]]:
    for sample in survey.samples:
        yield sample.sensor, sensor_text(survey, sample)
        if sample.drops:
            said = ', '.join(f'{reason} {count}x' for reason, count in sample.drops.items())
            yield '', f'of those looked at cannot be used: {said}'
    for kind, name in ((SensorKind.IMU, 'imu'), (SensorKind.GNSS, 'gnss')):
        if not any(sample.kind is kind for sample in survey.samples):
            yield name, 'none'


def sensor_text(survey: Survey, sample: SensorSample) -> str:
    """What a sensor is like, in one line.

    Args:
        survey: the look.
        sample: one of its samples.
    """
    if sample.kind is SensorKind.LIDAR:
        return _lidar(sample, survey.shapes.get(sample.sensor))
    return _imu(sample, survey) if sample.kind is SensorKind.IMU else _fixes(sample, survey)


def _lidar(sample: SensorSample, shape: LidarShape | None) -> str:
    fields = f'; fields {", ".join(sample.fields)}' if sample.fields else ''
    if shape is None:
        return f'no cloud could be read{fields}'
    parts = [
        f'about {shape.beams} beams, {shape.points} points a scan',
        f'{shape.near:.1f} m to {shape.far:.0f} m',
    ]
    if shape.turn < 0.6:
        parts.append(f'sees {100 * shape.turn:.0f} % of the directions around it')
    if shape.tilt > 1.0:
        parts.append(f'tilted by {shape.tilt:.0f} degrees')
    if shape.height is not None:
        parts.append(f'{shape.height:.1f} m above the ground')
    parts.append('points have times' if shape.timed else 'points have no times')
    return ', '.join(parts) + fields


def _imu(sample: SensorSample, survey: Survey) -> str:
    samples = [item for item in sample.measurements if isinstance(item, ImuSample)]
    if not samples:
        return 'no sample could be read'
    force = np.array([item.acceleration for item in samples])
    rates = np.degrees(np.linalg.norm([item.gyro for item in samples], axis=1))
    mean = survey.pose(sample.sensor)[:3, :3] @ force.mean(axis=0)
    axis = int(np.argmax(np.abs(mean)))
    up = f'{"-" if mean[axis] < 0 else "+"}{_AXES[axis]} of base_link'
    turned = any(item.orientation is not None for item in samples)
    return (
        f'acceleration {np.linalg.norm(force, axis=1).mean():.2f} m/s^2, most of it along {up}; '
        f'turns by {np.median(rates):.2f} deg/s, at most {rates.max():.1f} deg/s; '
        f'{"with" if turned else "no"} orientation'
    )


def _fixes(sample: SensorSample, survey: Survey) -> str:
    fixes = [item for item in sample.measurements if isinstance(item, GnssFix)]
    looked = len(fixes) + sum(sample.drops.values())
    reasons: Counter[str] = Counter()
    deviations = []
    for fix in fixes:
        try:
            covariance = checked_covariance(fix, survey.config.fixes)
        except MeasurementError as error:
            reasons[error.reason] += 1
            continue
        deviations.append(float(np.sqrt(covariance[:2, :2].trace() / 2.0)))
    usable = len(fixes) - sum(reasons.values())
    parts = [f'{usable} of {looked} looked at are usable']
    if reasons:
        parts[0] += f' ({", ".join(f"{reason} {n}x" for reason, n in reasons.items())})'
    states = Counter(fix.status.name for fix in fixes)
    if states:
        parts.append('status ' + ', '.join(f'{name} {count}x' for name, count in states.items()))
    known = sum(fix.covariance is not None for fix in fixes)
    if deviations:
        told = '' if known == len(fixes) else f', {len(fixes) - known} without covariance'
        parts.append(f'deviation {np.median(deviations):.2f} m{told}')
    flat = sum(not np.isfinite(fix.altitude) for fix in fixes)
    if flat:
        parts.append(f'{flat} without altitude')
    return '; '.join(parts)


def _start(survey: Survey) -> Iterator[tuple[str, str]]:
    files = ' and '.join(dict.fromkeys(choice.file for choice in survey.start))
    yield 'start', f'the defaults, with these of {files}' if files else 'the defaults'
    for choice in survey.start:
        yield '', f'{choice.text}  ({choice.why})'
