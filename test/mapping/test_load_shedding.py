"""Less search and merged windows leave the graph whole."""

from incremental_mapper.datasets.open import open_source
from incremental_mapper.mapping.load_shedding import LoadShedding
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.opened_drive import effective_config


def test_merged_windows_and_small_budgets_keep_the_graph_whole(light_drive):
    tree = {'mom': {'max_points': 100}}
    source = open_source(light_drive, tree)
    mapper = Mapper(effective_config(source, tree, 'test'), list(source.info.counts))
    shedding = LoadShedding(candidates=4, windows=3)
    for measurement in source.measurements():
        list(mapper.advance(measurement, shedding))
    list(mapper.drain(shedding))
    stats = mapper.stats()
    assert stats['merged_windows'] >= 12 and stats['windows'] <= 10
    assert stats['components'] == 1 and stats['bridges'] == 0
    assert stats['candidates_solved'] <= 4 * stats['windows']
    used = sum(len(item.cluster.members) for item in mapper.state.clusters)
    assert used == source.info.count - source.info.counts['imu']
