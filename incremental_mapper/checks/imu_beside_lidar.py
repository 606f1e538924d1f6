"""Rules for an IMU beside scan matching: the unit of its rates, its clock, how its axes stand."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.imu_force_unit import force_unit_finding
from incremental_mapper.checks.imu_motion import (
    MAX_LAG,
    Agreement,
    Axes,
    Comparison,
    MotionEvidence,
    compare_axes,
    smoothness,
)
from incremental_mapper.config import Imu
from incremental_mapper.geometry import written_numbers
from incremental_mapper.measurements import NANOSECONDS

CERTAIN = 40.0
"""Logarithm of a likelihood ratio above which the rotations belong together. Drives here that move
have 59 to 2800 over 5 to 60 s, one that stands 11 at the best of 800 lags."""
LIKELY = 20.0
"""The same where the rates are so large that they must be of another unit: chance has 14."""
RATE_UNITS = {float(np.pi / 180.0): 'deg/s', float(180.0 / np.pi): 'rad/s divided by 57.3'}
"""What makes rad/s of other units."""
NEAR_UNIT = 2.5
"""Factor by which the fitted scale may be off a unit's: with 5 s of a straight drive, where little
more than bumps turns the car, it is 0.57 to 1.18 times the true one."""
EXACT = 0.1
"""Largest relative deviation of a scale that is none of a unit's, to be believed."""
OFF, AGREEING, SIGMAS = 0.08, 0.95, 6.0
"""Share by which the fitted scale may be off 1 where the car turns, the correlation from which that
is asked, and how many of its standard deviations it must be. Drives here that turn have scales of
0.97 to 0.99 with correlations of 0.973 and more, and deviations of 0.002 to 0.008."""
OTHERWISE = 0.3
"""By how much the rotations correlate better with other axes where the extrinsics, or a sign, are
wrong. On drives here that turn it is 0.001."""
TOO_MUCH = 12.0
"""A gyroscope that turns so many times as much as the scans is wrong; 0.8 to 2 on all drives here,
50 in deg/s."""
MOVING = 0.001
"""rad; root mean square of the matches' rotations above which the car moves: 0.0003 while it
stands, 0.0015 on straight drives."""
TURNING = 0.008
"""rad; root mean square of the matches' rotations that a gyroscope cannot miss: mixed drives here
have 0.0095 to 0.029 with likelihoods above 1100, drives straight on at most 0.0038."""
SMOOTH = 0.7
"""Correlation of a match's rotation with the next one's above which it is the car that turns, and
no match's noise: 0.84 to 0.98 on mixed drives here, at most 0.59 straight on."""
FEW, MANY = 40, 150
"""Matches after which a gyroscope that has missed them all is given up, at the end and before."""
LAG = 0.03
"""Seconds by which the clocks may differ, on top of half a sweep: where clouds have no point times
the stamp may be that of either end. On the drives here the lag is 0.045 to 0.065 s without point
times (half a sweep is 0.05 s) and -0.015 to -0.025 s with them."""
CLOCK_GAIN = 10.0
"""Logarithm of the likelihood ratio that a lag needs beside none, in either half of the matches:
20 and more after 5 s for 0.1 s, while lags that are chance have at most 3."""
AXES_GAIN, AXES_LEAD = 30.0, 15.0
"""The same for axes that stand otherwise, and for their lead before the next best way. Right
extrinsics lose 0 to 0.8 on all drives here; after 5 s a quarter turn about any axis has a gain of
38 and more, and a lead of 25 and more; a car that stands has a lead of 0.4."""
TILTED = 20.0
"""Degrees by which the axes may be off; fits of 5 s are 2 to 13 degrees off where much is known."""
PATIENCE = 20.0
"""Seconds of matches after which an IMU whose axes contradict gravity is given up."""


def check_motion(
    evidence: MotionEvidence, settings: Imu, last: bool = False
) -> tuple[Finding, ...]:
    """Hold the IMU's rotation and accelerations against those of scan matching.

    Args:
        evidence: Matches and samples, with ``settings`` applied to these.
        settings: Those of the IMU.
        last: Whether nothing more will come, so that what is not certain is not waited for.

    Returns:
        What is wrong; empty where nothing is, or where too little turned.
    """
    frozen = _frozen_gyro(evidence)
    if frozen is not None:
        return (frozen,)
    comparison = Comparison(evidence)
    best, lag = comparison.best(), LAG + comparison.half
    together = best is not None and best.likelihood > CERTAIN
    if best is not None and (together or (_is_too_much(best) and best.likelihood > LIKELY)):
        unit = _rate_unit(best, settings)
        clock = _clock(comparison, best, settings) if together else None
        found = [one for one in (unit, clock) if one is not None]
        if not found and together and _turns_otherwise(best):
            other = _axes(compare_axes(evidence), settings) if abs(best.lag) <= lag else None
            return (other or _contradiction(best),)
        # With another clock the axes look wrong too; where none is certain, exchanged ones of the
        # gyroscope look like one.
        if found or abs(best.lag) > lag:
            mixed = _gyro_axes(compare_axes(evidence)) if together and not found else None
            return tuple(found) if mixed is None else (mixed,)
    elif best is not None and _disagrees(evidence, best, last):
        return (
            _switched_off(
                'imu_disagrees',
                f'turns by {np.degrees(best.imu):.2g} deg from scan to scan where scan matching '
                f'has {np.degrees(best.lidar):.2g}, and not at the same times',
            ),
        )
    axes = compare_axes(evidence)
    other = (_axes(axes, settings) or _gyro_axes(axes)) if together else None
    if other is not None:
        return (other,)
    seconds = float(evidence.spans.max() - evidence.spans.min()) / NANOSECONDS
    sure = axes.as_said and axes.lead > AXES_LEAD
    if not axes.was_upright and not sure and (last or seconds > PATIENCE):
        return (_not_upright(evidence, settings),)
    unit = force_unit_finding(evidence, settings) if together else None
    return () if unit is None else (unit,)


def _frozen_gyro(evidence: MotionEvidence) -> Finding | None:
    """A gyroscope that says one number while the accelerometer and the car live."""
    if np.ptp(evidence.gyro, axis=0).any() or not np.ptp(evidence.force, axis=0).all():
        return None
    seen = float(np.sqrt((evidence.turns**2).sum(axis=1).mean()))
    if seen < MOVING:
        return None
    x, y, z = evidence.gyro[0]
    return _switched_off(
        'imu_gyro_frozen',
        f'all {len(evidence.gyro)} angular rates are ({x:.3g}, {y:.3g}, {z:.3g}) while scan '
        f'matching turns by {np.degrees(seen):.2g} deg from scan to scan',
    )


def _is_too_much(best: Agreement) -> bool:
    """Whether the IMU turns so much that it cannot be in rad/s."""
    return best.lidar > MOVING and best.imu > TOO_MUCH * best.lidar


def _disagrees(evidence: MotionEvidence, best: Agreement, last: bool) -> bool:
    """Whether the IMU turns much more than the car, or does not where the car turns."""
    if best.count < (FEW if last else MANY):
        return False
    turns = best.lidar > TURNING and smoothness(evidence) > SMOOTH
    return turns or _is_too_much(best)


def _rate_unit(best: Agreement, settings: Imu) -> Finding | None:
    """The unit of the rates by the ratio of the two rotations."""
    if 1.0 / NEAR_UNIT < best.scale < NEAR_UNIT and not _is_off(best):
        return None
    text = (
        f'angular rates are {1.0 / best.scale:.3g} times those of scan matching '
        f'({best.count} matches, correlation {best.turned:.2f})'
    )
    for unit, name in RATE_UNITS.items():
        if 1.0 / NEAR_UNIT < best.scale / unit < NEAR_UNIT:
            factor = float(f'{unit * settings.rate_scale:.6g}')
            rule = 'imu_in_deg' if unit < 1.0 else 'imu_rate_unit'
            return _scaled(rule, f'{text}: they are in {name}', factor, Severity.MENDED)
    factor = float(f'{best.scale * settings.rate_scale:.3g}')
    exact = best.sigma < EXACT * best.scale
    severity = Severity.MENDED if exact else Severity.WARNING
    return _scaled('imu_rate_scale', text, factor, severity)


def _is_off(best: Agreement) -> bool:
    """Whether the scale is certainly not 1, as of a gyroscope whose full scale is set wrong."""
    if best.lidar < TURNING or best.turned < AGREEING:
        return False
    return abs(best.scale - 1.0) > max(OFF, SIGMAS * best.sigma)


def _scaled(rule: str, text: str, factor: float, severity: Severity) -> Finding:
    done = 'converted;' if severity is Severity.MENDED else 'perhaps'
    remedy = f'{done} imu.rate_scale: {factor:g}'
    return Finding(rule, severity, 'imu', text, remedy, {'imu': {'rate_scale': factor}})


def _clock(comparison: Comparison, best: Agreement, settings: Imu) -> Finding | None:
    """A clock that is ahead of the LiDARs' or behind."""
    now = comparison.at(0.0)
    if abs(best.lag) <= LAG + comparison.half:
        return None
    # Where nothing overlaps now there is nothing to be better than.
    if now is not None and comparison.support(best.lag) < CLOCK_GAIN:
        return None
    offset = round(settings.time_offset + best.lag, 3)
    inside = abs(best.lag) < MAX_LAG - LAG
    return Finding(
        'imu_clock',
        Severity.MENDED if inside else Severity.WARNING,
        'imu',
        f'its clock is {abs(best.lag):.3f} s {"behind" if best.lag > 0.0 else "ahead of"} the '
        f"LiDARs' ({best.count} matches, correlation {best.turned:.2f} with it, "
        f'{0.0 if now is None else now.turned:.2f} without)',
        f'{"shifted;" if inside else "at least so much;"} imu.time_offset: {offset:g}',
        {'imu': {'time_offset': offset}},
    )


def _axes(axes: Axes, settings: Imu) -> Finding | None:
    """Axes that stand otherwise than the extrinsics say."""
    if not axes.as_said and axes.gain > AXES_GAIN and axes.lead > AXES_LEAD:
        tree: dict[str, object] = {}
        said = []
        if axes.sign < 0:
            tree['acceleration_scale'] = -settings.acceleration_scale
            said.append(f'imu.acceleration_scale: {-settings.acceleration_scale:g}')
        if not (axes.rotation == np.eye(3)).all():
            tree['T_base_sensor'] = turned_extrinsics(axes.rotation, settings)
            said.append(f'imu.T_base_sensor: {tree["T_base_sensor"]}')
        if (not axes.upright and axes.was_upright) or axes.force_loss > AXES_GAIN:
            return _contradicted(
                f'rotation and acceleration fit those of scan matching only with {", ".join(said)}'
            )
        text = (
            'accelerations have the wrong sign'
            if len(said) == 1 and axes.sign < 0
            else f'its axes stand otherwise than T_base_sensor says: {_angle(axes.rotation):.0f} '
            'deg from there'
        )
        return Finding(
            'imu_sign' if text.startswith('acc') else 'imu_axes',
            Severity.MENDED,
            'imu',
            f'{text}, by gravity, rotation and acceleration of the scan matches',
            'mended; ' + ', '.join(said),
            {'imu': tree},
        )
    angle = _angle(axes.free @ axes.rotation.T)
    if axes.as_said and axes.free_gain > AXES_GAIN and angle > TILTED:
        numbers = turned_extrinsics(axes.free, settings)
        return _switched_off(
            'imu_axes',
            f'rotation and acceleration fit those of scan matching best with its axes '
            f'{angle:.0f} deg from where T_base_sensor puts them',
            'correct T_base_sensor of the LiDARs or of the IMU; '
            f'about imu.T_base_sensor: {numbers}',
        )
    return None


def _gyro_axes(axes: Axes) -> Finding | None:
    """Axes of the gyroscope alone that are named or signed otherwise."""
    if not axes.as_said or axes.rates_gain < AXES_GAIN or (axes.rates == np.eye(3)).all():
        return None
    signs = axes.rates.sum(axis=1)
    names = [
        ('-' if sign < 0.0 else '') + 'xyz'[int(np.abs(row).argmax())]
        for row, sign in zip(axes.rates, signs, strict=True)
    ]
    return _contradicted(
        f'x, y, z of the rotation are ({", ".join(names)}) of the gyroscope by scan matching'
    )


def _turns_otherwise(best: Agreement) -> bool:
    """Whether the gyroscope turns about other axes, or the other way, where the car turns."""
    return (
        best.lidar > TURNING and best.turned > AGREEING and best.turned - best.aligned > OTHERWISE
    )


def _contradiction(best: Agreement) -> Finding:
    """Rotation alone asks for other axes."""
    return _contradicted(
        f'rotation correlates with that of scan matching by {best.aligned:.2f}, and would by '
        f'{best.turned:.2f} with other axes'
    )


def _contradicted(what: str) -> Finding:
    """Rotation asks for other axes, and gravity or acceleration contradict."""
    return _switched_off(
        'imu_axes',
        f'{what}, which gravity or acceleration contradict: the LiDARs stand otherwise than their '
        'T_base_sensor says, or the axes of the gyroscope are not those of the accelerometer, or '
        'one of them has the wrong sign',
        'correct the driver, or T_base_sensor of the LiDARs',
    )


def _not_upright(evidence: MotionEvidence, settings: Imu) -> Finding:
    x, y, z = np.median(evidence.force, axis=0)
    return _switched_off(
        'imu_not_upright',
        f'gravity points to ({x:.1f}, {y:.1f}, {z:.1f}) m/s^2 in base_link, where up is '
        '(0, 0, 9.8), and the car moves too little to tell why',
        'correct the rotation in imu.T_base_sensor, or set imu.acceleration_scale: '
        f'{-settings.acceleration_scale:g} where only the sign is wrong',
    )


def _switched_off(rule: str, text: str, remedy: str = '') -> Finding:
    return Finding(
        rule,
        Severity.WARNING,
        'imu',
        text,
        f'it is not used (imu.enabled: false){"; " if remedy else ""}{remedy}',
        {'imu': {'enabled': False}},
        in_force=True,
    )


def turned_extrinsics(rotation: NDArray[np.float64], settings: Imu) -> list[float]:
    """``T_base_sensor`` as x, y, z, qx, qy, qz, qw with its axes turned by ``rotation`` (3, 3)."""
    transform = settings.matrix().copy()
    transform[:3, :3] = rotation @ transform[:3, :3]
    return written_numbers(transform)


def _angle(rotation: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1.0) / 2.0, -1.0, 1.0))))
