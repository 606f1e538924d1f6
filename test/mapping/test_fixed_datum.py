"""Sessions that are given one datum lie in one frame."""

import numpy as np
import pymap3d
import pytest
from test_georeferencing import ARM, DATUM, EPOCH, SECOND, drive, mapped, truth

from incremental_mapper.errors import ConfigError
from incremental_mapper.settings import make_config


def datum_at(east, north):
    """Settings of a datum that lies so many metres from the place where the drives start."""
    place = pymap3d.enu2geodetic(east, north, 3.0, *DATUM)
    return {
        'fixed': True,
        **dict(zip(('latitude', 'longitude', 'altitude'), map(float, place), strict=True)),
    }


def places(result):
    """Positions of base_link by stamp."""
    return dict(zip(result.trajectory.stamps.tolist(), result.trajectory.positions, strict=True))


def in_enu(stamp, heading, datum):
    """Where the car was, around the datum."""
    place = truth((stamp - EPOCH) / SECOND, heading).translation()
    given = (datum['latitude'], datum['longitude'], datum['altitude'])
    return np.array(pymap3d.geodetic2enu(*pymap3d.enu2geodetic(*place, *DATUM), *given))


@pytest.mark.parametrize(('east', 'north'), [(30.0, -20.0), (-2500.0, 1800.0)])
def test_two_sessions_of_one_street_lie_in_one_frame(east, north):
    datum, heading = datum_at(east, north), 1.2
    whole = drive(heading, seconds=4.0)
    # The second one starts a second later, with other fixes first.
    late = [item for item in whole if item.stamp > EPOCH + SECOND]
    first, second = (mapped(heading, measurements=part, datum=datum) for part in (whole, late))
    for result in (first, second):
        assert result.stats['georeferenced'] and not result.findings
        assert result.stats['datum'] == [datum['latitude'], datum['longitude'], datum['altitude']]
        errors = [at - in_enu(stamp, heading, datum) for stamp, at in places(result).items()]
        assert np.linalg.norm(errors, axis=1).max() < 0.2
    ours, theirs = places(first), places(second)
    shared = sorted(ours.keys() & theirs.keys())
    assert len(shared) > 10
    apart = [np.linalg.norm(ours[stamp] - theirs[stamp]) for stamp in shared]
    assert max(apart) < 0.2
    assert second.fixes[0] == pytest.approx(
        in_enu(EPOCH + SECOND, heading, datum) + heading_arm(heading), abs=0.3
    )


def heading_arm(heading):
    """The antenna's lever arm along the axes of the map."""
    return truth(0.0, heading).rotation().rotate(ARM)


def test_without_a_datum_the_second_session_has_an_origin_of_its_own():
    whole = drive(1.2, seconds=4.0)
    late = [item for item in whole if item.stamp > EPOCH + SECOND]
    ours, theirs = (places(mapped(1.2, measurements=part)) for part in (whole, late))
    shared = sorted(ours.keys() & theirs.keys())
    assert min(np.linalg.norm(ours[stamp] - theirs[stamp]) for stamp in shared) > 3.0


def test_a_place_that_is_not_switched_on_is_refused():
    with pytest.raises(ConfigError, match=r'set datum\.fixed: true'):
        make_config({'datum': {'latitude': 37.0, 'longitude': 127.0}})
