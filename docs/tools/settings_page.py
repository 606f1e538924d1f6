"""The page of all settings, made from the schema: type, default, range, unit, description."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from annotated_types import Ge, Gt, Le, Lt, MinLen
from markdown.extensions.toc import slugify
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from incremental_mapper.config import Config, LidarSensor, Sensor

HEAD = """---
search:
  boost: 3
---

# Configuration

Every setting, made from the schema (`incremental_mapper/config/`) when these pages are built.
The command line and the node share it: `--config FILE` of `map` and `evaluate` takes the same file
as `--params-file` of the node. A name that is not here, or a value out of its range, is refused
with one line that says what was expected. Which settings are worth a thought, and what to look at
when you change them, is in [Choosing and tuning](tuning.md).

```yaml
/**:                      # may be left out for the command line
  ros__parameters:
    lidars:
      names: [left, right]
      left: {topic: /points_left, T_base_sensor: [1.0, 0.6, 1.9, 0.0, 0.0, 0.0, 1.0]}
      right: {topic: /points_right, T_base_sensor: [1.0, -0.6, 1.9, 0.0, 0.0, 0.0, 1.0]}
    imu: {topic: /imu}
    gnss: {topic: /fix, T_base_sensor: [-0.3, 0.0, 1.7, 0.0, 0.0, 0.0, 1.0]}
    graph:
      lag: 2.0
```

The defaults are what measures best on all drives together. The shipped files hold only what is
special about a data set: `config/kaist.yaml`, `config/kitti.yaml`, `config/s3e.yaml`; and
`config/kaist_paper.yaml` has the choices of the paper. For an input of your own
`incremental_mapper check INPUT --write FILE` writes a file, each line with where it comes from.
"""
SENSORS = """A sensor has these three, wherever it stands: `lidars.NAME`, `imu`, `gnss`. Poses are
`T_base_sensor`: they map a point from the sensor's frame to `base_link` (x forward, y left, z up).
"""
UNITS = (
    (r'\bMB of (?:scans|the disk)', 'MB'),
    (r'm/s\^3/sqrt\(Hz\)', 'm/s³/√Hz'),
    (r'rad/s\^2/sqrt\(Hz\)', 'rad/s²/√Hz'),
    (r'm/s\^2/sqrt\(Hz\)', 'm/s²/√Hz'),
    (r'rad/s/sqrt\(Hz\)', 'rad/s/√Hz'),
    (r'm/sqrt\(Hz\)', 'm/√Hz'),
    (r'm/s\^2', 'm/s²'),
    (r'rad/s\b', 'rad/s'),
    (r'm/s\b', 'm/s'),
    (r'standard deviations', 'σ'),
    (r'\bradians\b', 'rad'),
    (r'\bdegrees\b', '°'),
    (r'\b[Ss]econds\b', 's'),
    (r'\b[Mm]etres\b', 'm'),
    (r'\bHz\b', 'Hz'),
)
"""Words of a description, the most special first, and the unit that they tell."""
TUNING = Path(__file__).resolve().parents[1] / 'tuning.md'
NO_UNIT = (
    'odometry.min_overlap',
    'odometry.covariance_scale',
    'closure.min_overlap',
    'mom.eigenvalue_ratio',
    'selection.tie_confidence',
    'selection.time_budget',
)
"""Numbers with a fraction that are ratios."""


@dataclass(frozen=True)
class Setting:
    """One setting as the page shows it."""

    name: str
    kind: str
    default: str
    bounds: str
    unit: str
    description: str


class SettingsPageError(ValueError):
    """The schema has something that the page cannot tell, such as a number without a unit."""


def sections() -> dict[str, type[BaseModel]]:
    """The sections of the schema that hold settings, by name; sensors apart."""
    found = {}
    for name, outer in Config.model_fields.items():
        kind = outer.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel) and kind is not Sensor:
            found[name] = kind
    return found


def settings(section: str, model: type[BaseModel]) -> Iterator[Setting]:
    """The settings of a section; raises SettingsPageError where one cannot be told."""
    for name, info in model.model_fields.items():
        yield _setting(f'{section}.{name}', info)


def advice() -> dict[str, str]:
    """Where the page on tuning tells of a setting: a link, by the setting's name."""
    found: dict[str, str] = {}
    title = ''
    for line in TUNING.read_text(encoding='utf-8').splitlines():
        if line.startswith('## '):
            title = line.removeprefix('## ')
        for name in re.findall(r'\(configuration\.md#([\w.]+)\)', line):
            found.setdefault(name, f'[{title}](tuning.md#{slugify(title, "-")})')
    return found


def page() -> str:
    """The whole page."""
    more = advice()
    found = {name: list(settings(name, model)) for name, model in sections().items()}
    sensors = list(settings('lidars.NAME', LidarSensor))
    parts = [HEAD, '## At a glance', _glance(found), '## Sensors {#lidars}', SENSORS]
    parts += [_entry(item, item.name.replace('NAME', 'name')) for item in sensors]
    for name, items in found.items():
        parts += [f'## {name}', _first_paragraphs(sections()[name].__doc__)]
        parts += [_entry(item, item.name, more.get(item.name)) for item in items]
    return '\n\n'.join(parts) + '\n'


def _glance(found: dict[str, list[Setting]]) -> str:
    paragraphs = ['**[sensors](#lidars)** topic, T_base_sensor, time_offset, sectors']
    for section, items in found.items():
        links = ', '.join(f'[{item.name.partition(".")[2]}](#{item.name})' for item in items)
        paragraphs.append(f'**[{section}](#{section})** {links}')
    body = '\n\n'.join(paragraphs)
    return f'<div class="glance" markdown>\n\n{body}\n\n</div>'


def _entry(item: Setting, anchor: str, more: str | None = None) -> str:
    facts = [item.kind, f'default {item.default}']
    facts += [item.bounds] if item.bounds else []
    facts += [f'unit {item.unit}'] if item.unit else []
    line = ' · '.join(facts)
    words = item.description if more is None else f'{item.description} More: {more}.'
    return f'### {item.name} {{#{anchor}}}\n\n{line}\n{{: .setting }}\n\n{words}'


def _setting(name: str, info: FieldInfo) -> Setting:
    description = ' '.join((info.description or '').split())
    if not description:
        raise SettingsPageError(f'{name} has no description')
    kind = info.annotation
    number = kind in (int, float)
    unit = _unit(name, description) if number else ''
    if kind is float and not unit and name not in NO_UNIT:
        raise SettingsPageError(f'{name}: its description names no unit: {description!r}')
    return Setting(name, _kind(info), _default(info), _bounds(info), unit, description)


def _unit(name: str, description: str) -> str:
    if name in NO_UNIT:
        return ''
    for pattern, unit in UNITS:
        if re.search(pattern, description):
            return unit
    return ''


def _kind(info: FieldInfo) -> str:
    kind: Any = info.annotation
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return 'one of ' + ', '.join(f'`{item.value}`' for item in kind)
    names = {float: 'number', int: 'whole number', bool: 'true or false', str: 'text'}
    return names.get(kind, 'names' if kind == tuple[str, ...] else '7 or 12 numbers')


def _default(info: FieldInfo) -> str:
    value = info.default
    if isinstance(value, StrEnum):
        return f'`{value.value}`'
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    if isinstance(value, tuple):
        return '`[' + ', '.join(f'{number:g}' for number in value) + ']`'
    if isinstance(value, str):
        return f'`{value}`' if value else 'empty'
    return f'`{value}`'


def _bounds(info: FieldInfo) -> str:
    parts = []
    for item in info.metadata:
        if isinstance(item, Ge):
            parts.append(f'from {_number(item.ge)}')
        elif isinstance(item, Gt):
            parts.append(f'above {_number(item.gt)}')
        elif isinstance(item, Le):
            parts.append(f'to {_number(item.le)}')
        elif isinstance(item, Lt):
            parts.append(f'below {_number(item.lt)}')
        elif isinstance(item, MinLen):
            parts.append('not empty')
    return ' '.join(parts)


def _number(bound: Any) -> str:
    """A bound in figures, thousands apart: 1 000 000."""
    return f'{bound:,}'.removesuffix('.0').replace(',', '\u202f')


def _first_paragraphs(text: str | None) -> str:
    return '\n'.join(line.strip() for line in (text or '').strip().splitlines())
