"""Time scales that clocks are set to by mistake, and how far they are from UTC."""

from incremental_mapper.measurements import NANOSECONDS

_TAI_MINUS_UTC = (
    (1483228800, 37),
    (1435708800, 36),
    (1341100800, 35),
    (1230768000, 34),
    (1136073600, 33),
    (915148800, 32),
)
"""Seconds of UTC since 1970 from which on TAI is so many seconds ahead of it."""
_TAI_MINUS_GPS = 19
_QUARTER = 900
"""Seconds; time zones are multiples of it."""
_HOUR, _DAY, _WEEK = 3600, 86400, 604800
_SHORT = ((_HOUR, 'the hour'), (_DAY, 'the day'), (_WEEK, 'the week'))
"""Time within which a clock may count: packets of LiDARs, sentences and frames of receivers."""
_MOST_QUARTERS = 26 * 4
"""Two clocks in time zones differ by 26 h at most."""


def known_offset(
    seconds: float, utc: int, tolerance: float, within: bool = False
) -> tuple[int, str] | None:
    """Tell which time scales differ by a number of seconds.

    Args:
        seconds: by which one clock is ahead of another.
        utc: a stamp of the other clock in nanoseconds since 1970.
        tolerance: seconds; the latencies of the two sensors' messages differ by less.
        within: whether it may be a clock that begins again with every hour, day or week. One that
            counts from power-up is taken for such a one where it is so by chance.

    Returns:
        The whole seconds by which they differ, and their name in words; None where no two scales
        do, or where the difference is nothing but latency.
    """
    tai = next((leap for since, leap in _TAI_MINUS_UTC if utc >= since * NANOSECONDS), 0)
    scales = {'': 0}
    if tai:
        gps = tai - _TAI_MINUS_GPS
        scales |= {
            f'TAI, {tai} s ahead of UTC': tai,
            f'UTC, {tai} s behind TAI': -tai,
            f'GPS time, {gps} s ahead of UTC': gps,
            f'UTC, {gps} s behind GPS time': -gps,
            f'TAI, {_TAI_MINUS_GPS} s ahead of GPS time': _TAI_MINUS_GPS,
            f'GPS time, {_TAI_MINUS_GPS} s behind TAI': -_TAI_MINUS_GPS,
        }
    for scale, leap in scales.items():
        quarters = round((seconds - leap) / _QUARTER)
        whole = quarters * _QUARTER + leap
        zone = abs(quarters) <= _MOST_QUARTERS or quarters * _QUARTER % _DAY == 0
        dated = utc >= _WEEK * NANOSECONDS
        hours = within and dated and quarters * _QUARTER % _HOUR == 0
        counted = _counted(utc / NANOSECONDS + seconds) if hours else ''
        if whole and (zone or counted) and abs(seconds - whole) <= tolerance:
            words = [scale, counted or _zone(quarters * _QUARTER)]
            return whole, ' and '.join(word for word in words if word)
    return None


def _counted(stamp: float) -> str:
    """In words what a clock counts within that begins again from 0; '' where it tells a date."""
    name = next((name for span, name in _SHORT if 0.0 <= stamp < span), '')
    return f'seconds of {name}' if name else ''


def _zone(seconds: int) -> str:
    if seconds == 0:
        return ''
    if seconds % _DAY == 0:
        days = seconds // _DAY
        return f'{days:+d} day' + ('s' if abs(days) > 1 else '')
    return f'a time zone of {seconds / 3600:+g} h'
