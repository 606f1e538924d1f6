"""Settings that a bag brings itself: those of the file beside it, and those that a look chose."""

from collections.abc import Collection
from pathlib import Path

from incremental_mapper.config import Tree
from incremental_mapper.datasets.topics import TopicChoice
from incremental_mapper.settings import read_yaml

SETTINGS_FILE = 'incremental_mapper.yaml'
"""The name of the file beside a bag."""


def own_settings(folder: Path, listed: list[str] | None) -> Tree:
    """The settings file beside a bag, without the LiDARs that the user does not list."""
    path = folder / SETTINGS_FILE
    if not path.is_file():
        return {}
    own = read_yaml(path)
    lidars = own.get('lidars')
    if listed is not None and isinstance(lidars, dict):
        kept = {name: lidars[name] for name in listed if name in lidars}
        own = {**own, 'lidars': {'names': list(listed), **kept}}
    return own


def topic_settings(choice: TopicChoice, configured: list[str]) -> Tree:
    """Settings tree that names the chosen topics."""
    chosen = {name: {'topic': topic.name} for name, topic in choice.topics.items()}
    lidars: Tree = {'names': configured or list(choice.lidars)}
    lidars |= {name: chosen[name] for name in choice.lidars}
    return {'lidars': lidars} | {
        name: value for name, value in chosen.items() if name not in choice.lidars
    }


def sector_settings(lidars: Collection[str]) -> Tree:
    """Settings tree that has the sectors of these LiDARs gathered."""
    return {'lidars': {name: {'sectors': True} for name in lidars}} if lidars else {}
