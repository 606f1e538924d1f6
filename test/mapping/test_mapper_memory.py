"""What a mapper holds beside the map is bounded by its settings, not by the drive."""

import pytest

from incremental_mapper.map.store import SpillingStore
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.settings import make_config


@pytest.mark.parametrize(('wanted', 'kept'), [(4, 20), (50, 50)])
def test_scans_for_scoring_are_no_more_than_windows_look_at(wanted, kept):
    mapper = Mapper(make_config({'mom': {'submap_scans': wanted}, 'lidars': {'names': ['left']}}))
    assert mapper.state.recent.maxlen == kept
    assert isinstance(mapper.state.store, SpillingStore), 'scans are bounded by default'
    mapper.close()
