"""Messages that no sensor sends: every one is worth nothing, and may do no harm.

None of them is a plausible measurement at a plausible time. What could be one, such as a scan whose
stamp is wrong by a tenth of a second, is a lie and not hostile; only those that repeat the stamp of
a message before them have values that could be true.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from lies.recording import (
    FIX,
    IMU,
    LIDARS,
    STORE,
    TYPES,
    Recording,
    cloud_of,
    points_of,
    restamped,
    stamp_of,
    table,
    vector,
)

Rng: TypeAlias = np.random.Generator
Spoil: TypeAlias = Callable[[Rng, Any], Any]
"""Makes a hostile message of a valid one: a message, or raw data."""

MOST = 2**32 - 1
FEW = 120
"""Points of a hostile cloud, where their number is not the matter."""
LONG = 'frame' * 4000
VALUES = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30, 1e9)


@dataclass(frozen=True)
class Sent:
    """A message as it goes over the wire: when it is sent (ns), where, what it is, its data.

    ``kind`` is '' where it is one of the drive's own.
    """

    logged: int
    topic: str
    kind: str
    data: bytes


def mixed(recording: Recording, count: int, seed: int) -> Iterator[Sent]:
    """The messages of a drive, truth included, with ``count`` hostile ones among them."""
    rng = np.random.default_rng(seed)
    items = recording.items
    first = next(i for i, item in enumerate(items) if item[1] in KINDS)
    after = np.bincount(rng.integers(first, len(items), count), minlength=len(items))
    newest: dict[str, Any] = {}
    for number, (logged, topic, message) in enumerate(items):
        yield Sent(logged, topic, '', bytes(STORE.serialize_cdr(message, message.__msgtype__)))
        if topic in KINDS:
            newest[topic] = message
        for _ in range(after[number]):
            target = str(rng.choice(list(newest)))
            yield _hostile(rng, logged, target, newest[target])


def valid(recording: Recording) -> Iterator[Sent]:
    """The messages of a drive alone."""
    return mixed(recording, 0, 0)


def _hostile(rng: Rng, logged: int, topic: str, message: Any) -> Sent:
    """A hostile message that is made of the newest one of a topic."""
    kind = str(rng.choice(list(KINDS[topic])))
    # Between two messages; a duplicate says so by itself.
    own = restamped(message, stamp_of(message) + int(rng.integers(1, 5_000_000)))
    made = KINDS[topic][kind](rng, message if kind.startswith('same_stamp') else own)
    return Sent(logged, topic, kind, made if isinstance(made, bytes) else as_data(made))


def _value(rng: Rng) -> float:
    return float(rng.choice(VALUES))


def _at(seconds: float) -> Spoil:
    """A valid message at another time."""
    return lambda _, m: restamped(m, stamp_of(m) + round(seconds * NANOSECONDS))


def _random_leap(rng: Rng, message: Any) -> Any:
    shift = int(10.0 ** rng.uniform(1.1, 8.3) * NANOSECONDS) * int(rng.choice([-1, 1]))
    return restamped(message, min(max(stamp_of(message) + shift, 1), (2**31 - 1) * NANOSECONDS))


def _stray(rng: Rng, message: Any) -> Any:
    """A stamp 1.5 s to an hour ahead or behind, which the clock of a driver may well give."""
    seconds = float(np.exp(rng.uniform(np.log(1.5), np.log(3600.0)))) * int(rng.choice([-1, 1]))
    return restamped(message, stamp_of(message) + round(seconds * NANOSECONDS))


def _header(**changes: Any) -> Spoil:
    """A message whose stamp is no time."""

    def spoil(_: Rng, message: Any) -> Any:
        stamp = replace(message.header.stamp, **changes)
        return replace(message, header=replace(message.header, stamp=stamp))

    return spoil


def as_data(message: Any) -> bytes:
    """A message as it goes over the wire."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def _short(rng: Rng, message: Any) -> bytes:
    data = as_data(message)
    return data[: int(rng.integers(4, len(data)))]


def _noise(rng: Rng, message: Any) -> bytes:
    return as_data(message)[:4] + rng.bytes(int(rng.integers(0, 2000)))


def _long_name(_: Rng, message: Any) -> bytes:
    """The length of the frame_id is that of all memory."""
    data = bytearray(as_data(message))
    data[12:16] = b'\xff\xff\xff\x7f'
    return bytes(data)


def _no_text(_: Rng, message: Any) -> bytes:
    """A frame_id that is no UTF-8."""
    data = bytearray(as_data(message))
    data[16:18] = b'\xff\xfe'
    return bytes(data)


ANY: dict[str, Spoil] = {
    'stamp_zero': _header(sec=0, nanosec=0),
    'stamp_negative': _header(sec=-5),
    'stamp_nanoseconds': _header(sec=2**31 - 1, nanosec=MOST),
    'stamp_boot': _header(sec=12),
    'leap_minute': _at(60.0),
    'leap_hour': _at(3600.0),
    'leap_back': _at(-30.0),
    'leap_random': _random_leap,
    'stray': _stray,
    'same_stamp': lambda _, m: m,
    'same_stamp_no_frame': lambda _, m: replace(m, header=replace(m.header, frame_id='')),
    'same_stamp_long_frame': lambda _, m: replace(m, header=replace(m.header, frame_id=LONG)),
    'raw_short': _short,
    'raw_empty': lambda _, m: as_data(m)[:4],
    'raw_noise': _noise,
    'raw_long_name': _long_name,
    'raw_no_text': lambda rng, m: _no_text(rng, restamped(m, 1)),
}
"""What may befall every message, by kind."""


def _cloud(**changes: Any) -> Spoil:
    """A cloud that says something wrong of its layout."""

    def spoil(_: Rng, cloud: Any) -> Any:
        return cloud_of(cloud, table(points_of(cloud)[:FEW]), **changes)

    return spoil


def _points(make: Callable[[Rng, Any], Any], code: str = '<f4') -> Spoil:
    """A cloud of other points."""
    return lambda rng, cloud: cloud_of(
        cloud, table(np.asarray(make(rng, points_of(cloud)[:FEW])), code)
    )


def _fields(change: Callable[[Rng, Any], Any]) -> Spoil:
    """A cloud of other fields."""

    def spoil(rng: Rng, cloud: Any) -> Any:
        small = cloud_of(cloud, table(points_of(cloud)[:FEW]))
        return replace(small, fields=[change(rng, field) for field in small.fields])

    return spoil


def _many_fields(_: Rng, cloud: Any) -> Any:
    small = cloud_of(cloud, table(points_of(cloud)[:FEW]))
    return replace(small, fields=[replace(small.fields[0], name=f'f{i}') for i in range(500)])


def _some_layout(rng: Rng, cloud: Any) -> Any:
    sizes = [0, 1, 3, 12, 119, 2**16, MOST]
    small = cloud_of(cloud, table(points_of(cloud)[:FEW]))
    words = ('width', 'height', 'point_step', 'row_step')
    return replace(small, **{word: int(rng.choice(sizes)) for word in words})


def _wild_times(rng: Rng, cloud: Any) -> Any:
    points = points_of(cloud)
    times = rng.choice(VALUES, len(points))
    return cloud_of(cloud, table(points, time=('<f8', times)))


def _few_far(rng: Rng, cloud: Any) -> Any:
    """A whole cloud with a few points where no LiDAR sees."""
    points = np.array(points_of(cloud), dtype=np.float32)
    some = rng.integers(0, len(points), 50)
    points[some] *= np.float32(10.0) ** rng.uniform(6.0, 30.0, (50, 1)).astype(np.float32)
    return cloud_of(cloud, table(points))


CLOUDS: dict[str, Spoil] = {
    'width_most': _cloud(width=MOST),
    'height_most': _cloud(height=MOST),
    'sizes_most': _cloud(width=MOST, height=MOST),
    'width_zero': _cloud(width=0),
    'point_step_zero': _cloud(point_step=0),
    'point_step_most': _cloud(point_step=MOST),
    'same_stamp_row_step_most': _cloud(row_step=MOST, height=2, width=FEW // 2),
    'data_empty': _cloud(data=np.zeros(0, dtype=np.uint8)),
    'data_short': _cloud(data=np.ones(100, dtype=np.uint8)),
    'some_layout': _some_layout,
    'no_fields': _cloud(fields=[]),
    'many_fields': _many_fields,
    'fields_unnamed': _fields(lambda _, f: replace(f, name='')),
    'fields_named_otherwise': _fields(lambda _, f: replace(f, name=f.name.upper())),
    'fields_all_x': _fields(lambda _, f: replace(f, name='x')),
    'fields_of_no_type': _fields(lambda rng, f: replace(f, datatype=int(rng.choice([0, 9, 255])))),
    'fields_far_off': _fields(lambda rng, f: replace(f, offset=int(rng.choice([12, MOST])))),
    'points_none': _points(lambda _, p: p[:0]),
    'points_two': _points(lambda _, p: p[:2]),
    'points_nan': _points(lambda _, p: p * np.nan),
    'points_infinite': _points(lambda _, p: p + np.inf),
    'points_zero': _points(lambda _, p: p * 0.0),
    'points_beyond_single': _points(lambda _, p: p.astype(float) * 1e300, '<f8'),
    'points_far': _points(lambda _, p: p * 1e20),
    'points_far_by_any_factor': _points(lambda rng, p: p * 10.0 ** rng.uniform(6.0, 30.0)),
    'same_stamp_few_far': _few_far,
    'points_one_place': _points(lambda _, p: np.tile(p[:1], (500, 1))),
    'points_noise': _points(
        lambda rng, p: np.frombuffer(rng.bytes(12 * 5 * FEW), dtype='<f4').reshape(-1, 3)
    ),
    'points_many_nan': _points(lambda _, p: np.full((100_000, 3), np.nan)),
    'same_stamp_wild_times': _wild_times,
}


def _sample(**values: Callable[[Rng], Any]) -> Spoil:
    return lambda rng, m: replace(m, **{name: make(rng) for name, make in values.items()})


def _wild_vector(rng: Rng) -> Any:
    return vector([_value(rng) for _ in range(3)])


def _absurd(*sizes: float) -> Callable[[Rng], Any]:
    """A vector of finite values that no sensor gives, each with any sign."""
    return lambda rng: vector([float(rng.choice(sizes) * rng.choice([-1, 1])) for _ in range(3)])


def _wild_turn(rng: Rng) -> Any:
    x, y, z, w = (_value(rng) for _ in range(4))
    return TYPES['geometry_msgs/msg/Quaternion'](x=x, y=y, z=z, w=w)


def _wild_nine(rng: Rng) -> Any:
    return np.array([_value(rng) for _ in range(9)])


SAMPLES: dict[str, Spoil] = {
    'rates_wild': _sample(angular_velocity=_wild_vector),
    'accelerations_wild': _sample(linear_acceleration=_wild_vector),
    'rates_absurd': _sample(angular_velocity=_absurd(100.0, 1000.0, 1e5, 1e300)),
    'accelerations_absurd': _sample(linear_acceleration=_absurd(500.0, 1e4, 1e5, 1e300)),
    'rates_absent': _sample(angular_velocity_covariance=lambda _: np.array([-1.0] + [0.0] * 8)),
    'same_stamp_wild_turn': _sample(orientation=_wild_turn),
    'same_stamp_wild_covariance': _sample(
        orientation_covariance=_wild_nine, angular_velocity_covariance=_wild_nine
    ),
}

FIXES: dict[str, Spoil] = {
    'latitude_wild': _sample(latitude=_value),
    'longitude_wild': _sample(longitude=_value),
    'nowhere': _sample(latitude=lambda _: 0.0, longitude=lambda _: 0.0),
    'no_fix': lambda _, m: replace(m, status=replace(m.status, status=-1)),
    'status_unknown': lambda _, m: replace(m, status=replace(m.status, status=-128)),
    'elsewhere': _sample(
        latitude=lambda rng: float(rng.uniform(-60.0, 60.0)),
        longitude=lambda rng: float(rng.uniform(-180.0, 180.0)),
    ),
    'near_elsewhere': lambda rng, m: replace(
        m, latitude=m.latitude + float(rng.choice([-1, 1]) * rng.uniform(0.001, 1.0))
    ),
    'same_stamp_absurd_covariance': _sample(
        position_covariance=lambda rng: np.diag(rng.choice([0.0, 1e300, -1.0, np.nan], 3)).ravel()
    ),
    'same_stamp_altitude_wild': _sample(altitude=_value),
    'same_stamp_wild_covariance': _sample(position_covariance=_wild_nine),
    'same_stamp_wild_type': _sample(position_covariance_type=lambda _: 255),
}

KINDS: dict[str, dict[str, Spoil]] = {
    **dict.fromkeys(LIDARS, ANY | CLOUDS),
    IMU: ANY | SAMPLES,
    FIX: ANY | FIXES,
}
"""What may befall the messages of each topic."""
