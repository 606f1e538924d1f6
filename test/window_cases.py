"""Windows of all kinds, for properties of what is made of them."""

import numpy as np
from hypothesis import strategies as st

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement, SpanBias
from incremental_mapper.candidates.partitions import group_elements
from incremental_mapper.candidates.spans import ImuStamps

SENSORS = {'left': CoreKind.LIDAR, 'right': CoreKind.LIDAR, 'gps': CoreKind.GNSS}


def imu_at(stamps, max_gap=10**12, bias=SpanBias.EACH_END):
    return ImuStamps(np.array(sorted(stamps), dtype=np.int64), max_gap, bias)


@st.composite
def windows(draw):
    """Up to six core measurements, a head or none, and few to many IMU samples."""
    keys = draw(
        st.sets(
            st.tuples(st.integers(0, 60), st.sampled_from(sorted(SENSORS))), min_size=1, max_size=6
        )
    )
    core = [CoreMeasurement(stamp, sensor, SENSORS[sensor]) for stamp, sensor in sorted(keys)]
    head = draw(st.none() | st.integers(-20, -1))
    imu = draw(st.sets(st.integers(-25, 65), max_size=40))
    bias = draw(st.sampled_from(SpanBias))
    return group_elements(core), head, imu_at(imu, draw(st.sampled_from([8, 10**12])), bias)
