"""Measurements that were used, but not as they were: what that means for the map."""

from incremental_mapper.checks.finding import Finding, Severity

_SEVERITIES = {
    'wrong_row_step': Severity.MENDED,
    'wrong_layout': Severity.MENDED,
    'field_names': Severity.MENDED,
    'millimetres': Severity.MENDED,
    'constant_range': Severity.MENDED,
    'absurd_times': Severity.MENDED,
    'no_altitude': Severity.MENDED,
    'no_vertical_variance': Severity.MENDED,
    'swapped_fix': Severity.MENDED,
}


def remarked(sensor: str, reason: str, text: str, count: int, total: int) -> Finding:
    """What was remarked of some of a sensor's measurements.

    Args:
        sensor: Its name.
        reason: The word that they were counted by, see ``measurements.Remark``.
        text: What was wrong with the first of them, and what was done about it.
        count: How many there were.
        total: How many measurements the sensor has.
    """
    severity = _SEVERITIES.get(reason, Severity.WARNING)
    return Finding(reason, severity, sensor, f'{count} of {total}: {text}')
