"""Settings for an input, written with a comment on every line: for ``map`` and for the node."""

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from incremental_mapper.config import Tree
from incremental_mapper.datasets.bag_writer import TOPICS
from incremental_mapper.datasets.sampling import SensorKind, SensorSample
from incremental_mapper.errors import OutputError
from incremental_mapper.results.survey import Survey
from incremental_mapper.results.survey_text import clock_text, rate_text, sensor_text
from incremental_mapper.settings import merge

_INDENT = '  '
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def refuse_existing(path: Path, force: bool) -> None:
    """Raise OutputError where a file is there that may not be replaced."""
    if path.is_dir():
        raise OutputError(f'{path}: is a folder; give the name of a settings file')
    if path.exists() and not force:
        raise OutputError(f'{path}: exists; use --force to replace it, or another name')


def write_settings(path: Path, survey: Survey, tree: Tree, where: str) -> None:
    """Write the settings of an input.

    Args:
        path: the file.
        survey: a look at the input.
        tree: the user's settings, which stay.
        where: where they come from.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        path.write_text(settings_text(survey, tree, where, path), encoding='utf-8')
    except OSError as error:
        raise OutputError(f'{path}: cannot be written ({error.strerror})') from error


def settings_text(survey: Survey, tree: Tree, where: str, path: Path) -> str:
    """The file's text, in the layout of a ROS parameter file.

    Args:
        survey: a look at the input.
        tree: the user's settings, which stay.
        where: where they come from.
        path: the file's name, for the commands in its head.
    """
    info = survey.info
    files = ' and '.join(dict.fromkeys(choice.file for choice in survey.start))
    head = [
        f'Settings for {info.path.name} ({info.kind}), written by "incremental_mapper check".',
        f'incremental_mapper map {shlex.quote(str(info.path))} OUT --config '
        f'{shlex.quote(str(path))}',
        f'mapper_node --ros-args --params-file {shlex.quote(str(path))}',
        f'Starting point: {f"the defaults with what {files} has" if files else "the defaults"}.'
        ' What is not named here has its default.',
    ]
    places, comments = _sensors(survey)
    for choice in survey.start:
        places = merge(places, choice.tree())
        comments[choice.place] = f'as in {choice.file}: {choice.why}'
    places = merge(places, tree)
    comments |= dict.fromkeys(_places(tree), f'from {where}')
    for found in survey.findings:
        if not found.changes:
            continue
        places = merge(places, found.settings)
        comments |= dict.fromkeys(_places(found.settings), f'{found.text} ({found.rule})')
    lines = [*(f'# {line}' for line in head), '/**:', f'{_INDENT}ros__parameters:']
    return '\n'.join([*lines, *_lines(places, comments, '', 2)]) + '\n'


def _sensors(survey: Survey) -> tuple[Tree, dict[str, str]]:
    """The sensors' sections, and comments by the names of settings."""
    lidars: Tree = {'names': []}
    others: Tree = {}
    comments: dict[str, str] = {'lidars.names': 'those that were found'}
    for sample in survey.samples:
        name = sample.sensor
        place = f'lidars.{name}' if sample.kind is SensorKind.LIDAR else name
        section = _section(survey, sample)
        if sample.kind is SensorKind.LIDAR:
            lidars['names'].append(name)
            lidars[name] = section
        else:
            others[name] = section
        comments[place] = sensor_text(survey, sample)
        comments[f'{place}.topic'] = (
            f'{sample.count} messages, {rate_text(sample)}'
            if sample.topic
            else 'in a folder there are none; "convert" writes this one'
        )
        frame = f', frame {sample.frame}' if sample.frame else ''
        comments[f'{place}.T_base_sensor'] = (
            f'from {sample.origin}{frame}'
            if _is_placed(sample)
            else f'NOT KNOWN{frame}: set x, y, z, qx, qy, qz, qw of the sensor in base_link; as '
            'long as it is not set, what the data show of it is used'
        )
        clock = clock_text(sample)
        comments[f'{place}.time_offset'] = (
            f'stamp - record time is {clock}' if clock else 'no time of recording to compare with'
        )
    return {'lidars': lidars, **others}, comments


def _is_placed(sample: SensorSample) -> bool:
    """Whether anything tells where a sensor is."""
    return not sample.origin.startswith('nowhere')


def _section(survey: Survey, sample: SensorSample) -> Tree:
    """Topic, extrinsics and offset of a sensor, as they are in force; unknown ones are None."""
    info, name = survey.info, sample.sensor
    lidar = sample.kind is SensorKind.LIDAR
    owner = info.settings.get('lidars', {}) if lidar else info.settings
    own = owner.get(name, {})
    pose = own.get('T_base_sensor', IDENTITY)
    return {
        'topic': sample.topic or TOPICS.get(name, ''),
        'T_base_sensor': [float(number) for number in pose] if _is_placed(sample) else None,
        'time_offset': survey.sensor(name).time_offset,
    }


def _places(tree: Mapping[str, Any], above: str = '') -> Iterator[str]:
    """Dotted names of all settings in a tree."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _places(value, f'{above}{name}.')
        else:
            yield f'{above}{name}'


def _lines(
    tree: Mapping[str, Any], comments: Mapping[str, str], above: str, depth: int
) -> Iterator[str]:
    indent = _INDENT * depth
    for name, value in tree.items():
        comment = comments.get(f'{above}{name}')
        if isinstance(value, Mapping):
            yield f'{indent}{name}:' + (f'  # {comment}' if comment else '')
            yield from _lines(value, comments, f'{above}{name}.', depth + 1)
            continue
        # A setting that a file names is not questioned: what is not known may not stand in it.
        out, known = ('# ', list(IDENTITY)) if value is None else ('', value)
        text = yaml.safe_dump(known, default_flow_style=True, width=10_000).strip()
        text = text.removesuffix('...').strip()
        yield f'{indent}{out}{name}: {text}' + (f'  # {comment}' if comment else '')
