"""Settings as files and nested dictionaries: read, laid over each other, checked, written.

A YAML file may hold the sections directly or in the layout of a ROS parameter file
(``/**: ros__parameters: ...``). Unknown names and values out of range raise ConfigError.
"""

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from incremental_mapper.config import Config, Sensor, Tree
from incremental_mapper.errors import ConfigError


def merge(low: Mapping[str, Any], high: Mapping[str, Any]) -> Tree:
    """Nested dictionaries laid over each other; ``high`` wins."""
    merged: Tree = dict(low)
    for key, value in high.items():
        below = merged.get(key)
        both = isinstance(value, Mapping) and isinstance(below, Mapping)
        merged[key] = merge(below, value) if both else value  # type: ignore[arg-type]
    return merged


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
    try:
        return Config.model_validate(dict(tree))
    except ValidationError as error:
        lines = [_explain(dict(item)) for item in error.errors()]
        raise ConfigError(f'{where}: ' + '; '.join(lines)) from error


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


def _explain(item: dict[str, Any]) -> str:
    location = [str(part) for part in item['loc']]
    name = '.'.join(location)
    if item['type'] == 'extra_forbidden':
        known = _names_beside(location)
        close = difflib.get_close_matches(location[-1], known, n=1, cutoff=0.5)
        remedy = f'did you mean {close[0]!r}?' if close else f'known names: {", ".join(known)}'
        return f'{name} is no setting; {remedy}'
    message = str(item['msg']).removeprefix('Value error, ').removeprefix('Input ')
    return f'{name} is {item.get("input")!r}; {message}'


def _names_beside(location: list[str]) -> list[str]:
    model: type[BaseModel] = Config
    for part in location[:-1]:
        field = model.model_fields.get(part)
        kind = field.annotation if field else None
        model = kind if isinstance(kind, type) and issubclass(kind, BaseModel) else Sensor
    return sorted(model.model_fields)
