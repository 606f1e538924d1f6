"""Settings as files and nested dictionaries: read, laid over each other, checked, written.

A YAML file may hold the sections directly or in the layout of a ROS parameter file
(``/**: ros__parameters: ...``). Unknown names and values out of range raise ConfigError.
"""

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from incremental_mapper.config import Config, Sensor, Tree
from incremental_mapper.errors import ConfigError

_FEW = 5
"""Unknown names that are listed; a wrong file may have hundreds."""


def merge(low: Mapping[str, Any], high: Mapping[str, Any]) -> Tree:
    """Nested dictionaries laid over each other; ``high`` wins."""
    merged: Tree = dict(low)
    for key, value in high.items():
        below = merged.get(key)
        both = isinstance(value, Mapping) and isinstance(below, Mapping)
        merged[key] = merge(below, value) if both else value  # type: ignore[arg-type]
    return merged


def as_it_was(before: Mapping[str, Any], changed: Mapping[str, Any]) -> Tree:
    """What ``before`` says of the settings that ``changed`` names."""
    return {
        key: as_it_was(before.get(key, {}), value) if isinstance(value, Mapping) else before[key]
        for key, value in changed.items()
        if key in before
    }


def read_yaml(path: Path) -> Tree:
    """Read a settings file in either layout; raises ConfigError."""
    try:
        tree = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise ConfigError(f'{path}: cannot be read ({error.strerror})') from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        message = ' '.join(str(error).split())
        raise ConfigError(f'{path}: is no YAML ({message})') from error
    if tree is None:
        return {}
    if isinstance(tree, dict):
        for value in tree.values():
            if isinstance(value, dict) and 'ros__parameters' in value:
                tree = value['ros__parameters'] or {}
                break
    if not isinstance(tree, dict):
        raise ConfigError(f'{path}: holds {type(tree).__name__}, expected sections of settings')
    return tree


def make_config(tree: Mapping[str, Any], where: str = 'settings') -> Config:
    """Check a nested dictionary against the schema; ``where`` names its origin in messages."""
    strangers = [str(name) for name in tree if name not in Config.model_fields]
    if strangers and len(strangers) == len(tree) and not _close(strangers):
        told = ', '.join(strangers[:_FEW]) + ' and more' * (len(strangers) > _FEW)
        are = 'is no section' if len(strangers) == 1 else 'are no sections'
        raise ConfigError(
            f'{where}: is no settings file: {told} {are}; known names: '
            f'{", ".join(sorted(Config.model_fields))}'
        )
    try:
        return Config.model_validate(dict(tree))
    except ValidationError as error:
        raise ConfigError(f'{where}: ' + '; '.join(_explain(error))) from error


def load_config(path: Path | str) -> Config:
    """Read a settings file.

    Args:
        path: YAML with the sections directly, or in the layout of a ROS parameter file.

    Returns:
        The settings; what the file does not name has its default.

    Raises:
        ConfigError: The file cannot be read, or a name or a value in it is wrong.
    """
    return make_config(read_yaml(Path(path)), str(path))


def to_tree(config: Config) -> Tree:
    """The settings as a nested dictionary of plain values, in the layout that YAML files use."""
    tree: Tree = config.model_dump(mode='json')
    tree['lidars'] = {'names': list(config.lidars), **tree['lidars']}
    return tree


def write_ros_yaml(path: Path, tree: Mapping[str, Any], comment: str = '') -> None:
    """Write a settings tree as a ROS parameter file."""
    head = ''.join(f'# {line}\n' for line in comment.splitlines())
    body = yaml.safe_dump(
        {'/**': {'ros__parameters': dict(tree)}}, sort_keys=False, default_flow_style=None
    )
    path.write_text(head + body, encoding='utf-8')


def _explain(error: ValidationError) -> list[str]:
    """What is wrong, setting by setting; the known names of a section once."""
    lines: list[str] = []
    unknown: dict[tuple[str, ...], list[str]] = {}
    for item in error.errors():
        *section, last = (str(part) for part in item['loc'])
        name = '.'.join([*section, last])
        if item['type'] != 'extra_forbidden':
            message = str(item['msg']).removeprefix('Value error, ').removeprefix('Input ')
            lines.append(f'{name} is {item.get("input")!r}; {message}')
            continue
        close = difflib.get_close_matches(last, _names_in(section), n=1, cutoff=0.5)
        if close:
            lines.append(f'{name} is no setting; did you mean {close[0]!r}?')
        else:
            unknown.setdefault(tuple(section), []).append(name)
    for parts, names in unknown.items():
        told = ', '.join(names[:_FEW]) + ' and more' * (len(names) > _FEW)
        are = 'is no setting' if len(names) == 1 else 'are no settings'
        lines.append(f'{told} {are}; known names: {", ".join(_names_in(parts))}')
    return lines


def _close(names: Sequence[str]) -> bool:
    """Whether half of the names are those of sections, with an error of typing."""
    known = list(Config.model_fields)
    close = [difflib.get_close_matches(name, known, n=1, cutoff=0.75) for name in names]
    return 2 * sum(map(bool, close)) >= len(names)


def _names_in(section: Sequence[str]) -> list[str]:
    model: type[BaseModel] = Config
    for part in section:
        field = model.model_fields.get(part)
        kind = field.annotation if field else None
        model = kind if isinstance(kind, type) and issubclass(kind, BaseModel) else Sensor
    return sorted(model.model_fields)
