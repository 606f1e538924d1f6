"""Where no fix says which way is north, the map keeps the axes that it began with."""

from contextlib import closing

import numpy as np

from incremental_mapper.datasets.open import open_source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import GnssFix
from incremental_mapper.settings import make_config, merge


def test_map_without_fixes_does_not_swing_about_its_origin(light_drive):
    source = open_source(light_drive, {})
    quick = {'odometry': {'processes': False, 'match_range': 45.0}, 'mom': {'max_points': 100}}
    config = make_config(merge(source.info.settings, quick), 'test')
    headings = []
    with closing(Mapper(config, ['left', 'right', 'imu'])) as mapper:
        for item in source.measurements():
            for _ in mapper.push(item) if not isinstance(item, GnssFix) else ():
                state = mapper.state
                headings.append(state.pose(state.clusters[0].id).rotation().yaw())
    assert len(headings) > 5
    assert np.ptp(headings) < np.radians(0.1)
