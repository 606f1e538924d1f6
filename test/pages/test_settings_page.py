"""The page of settings tells of every setting what the schema says."""

import re

import pytest
import settings_page
from pydantic import BaseModel, Field

from incremental_mapper.config import Config, Sensor
from incremental_mapper.settings import to_tree

PAGE = settings_page.page()


def entry(name: str) -> str:
    """What the page says of a setting, from its heading to the next one."""
    match = re.search(rf'^### {re.escape(name)} \{{.*?\n\n(.*?)(?=^##|\Z)', PAGE, re.M | re.S)
    assert match is not None, name
    return match[1]


def test_every_setting_has_an_entry_and_a_link() -> None:
    tree = to_tree(Config())
    for section in settings_page.sections():
        for name in tree[section]:
            assert entry(f'{section}.{name}')
            assert f'[{name}](#{section}.{name})' in PAGE
    for name in Sensor.model_fields:
        assert entry(f'lidars.NAME.{name}')


def test_an_entry_has_type_default_range_unit_and_description() -> None:
    lag = entry('graph.lag')
    assert lag.startswith('number · default `2.0` · from 0 to 60 · unit s')
    assert 'newest part of G(t)' in lag
    assert 'More: [The lag](tuning.md#the-lag).' in lag
    assert 'whole number · default `1000` · from 1 to 1\u202f000\u202f000\n' in entry(
        'selection.max_candidates'
    )
    assert 'one of `kiss_icp`, `gicp` · default `gicp`' in entry('odometry.method')
    assert 'true or false · default `true`' in entry('graph.final_optimization')
    assert 'above 0 to 10\u202f000 · unit rad/s²/√Hz' in entry('preintegration.gyroscope_bias_walk')
    assert 'text · default empty' in entry('save.on_shutdown')
    assert 'not empty' in entry('frames.map')


@pytest.mark.parametrize(
    ('name', 'unit'),
    [
        ('odometry.sigma_rotation', 'rad'),
        ('odometry.sigma_translation', 'm'),
        ('fixes.robust_threshold', 'σ'),
        ('preintegration.gravity', 'm/s²'),
        ('graph.prior_sigma_velocity', 'm/s'),
        ('graph.prior_sigma_gyroscope_bias', 'rad/s'),
        ('window.duration', 's'),
    ],
)
def test_units_come_from_the_descriptions(name: str, unit: str) -> None:
    assert f'unit {unit}\n' in entry(name)


def test_a_number_without_a_unit_or_a_setting_without_words_is_told() -> None:
    class Bare(BaseModel):
        length: float = Field(default=1.0, description='How long it is.')

    class Silent(BaseModel):
        count: int = 1

    with pytest.raises(settings_page.SettingsPageError, match=r'x\.length'):
        list(settings_page.settings('x', Bare))
    with pytest.raises(settings_page.SettingsPageError, match=r'x\.count has no description'):
        list(settings_page.settings('x', Silent))
