"""How far a fix may be from where those before it and odometry put it."""

import numpy as np
import pytest

from incremental_mapper.frontend.fix_tracks import Entry, Track
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.frontend.odometry_track import Place
from incremental_mapper.measurements import NANOSECONDS, FixStatus, GnssFix

DATUM = (36.4, 129.0, 90.0)
SIGMA = 0.05


def entry(second, loose):
    stamp = 1_544_676_777 * NANOSECONDS + second * NANOSECONDS
    fix = GnssFix(stamp, 'gnss', *DATUM, FixStatus.GBAS)
    return Entry(fix, Place(stamp, np.zeros(3), 0.0, 0.0, 0.0, 0.0, loose, 0.0), SIGMA, SIGMA)


@pytest.mark.filterwarnings('error')
def test_what_matches_may_be_off_may_have_shrunk_since_the_fix_before():
    """The last motion goes on between two scans; the match that comes knows the way better."""
    track = Track(Datum(*DATUM), 1.0)
    track.add(entry(0, loose=0.04), 0.0, 0)
    sure, unsure = (track.disagreement(entry(1, loose), None)[1] for loose in (0.01, 0.09))
    assert np.isfinite(sure) and sure < unsure
