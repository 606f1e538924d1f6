"""The settings as ROS parameters: names, types, ranges and descriptions follow the schema."""

from collections.abc import Collection, Iterator, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

from annotated_types import Ge, Gt, Le
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from incremental_mapper.config import Config, LidarSensor, Tree
from incremental_mapper.errors import ConfigError
from incremental_mapper.exports.formats import check_formats
from incremental_mapper.results.new_folder import obstacle
from incremental_mapper.settings import make_config, merge, to_tree

CHANGEABLE = (
    'map.publish_period',
    'path.publish_period',
    'graph.markers_period',
    'graph.markers_span',
    'save.folder',
    'save.on_shutdown',
    'save.fallback',
)
"""Parameters that may change while the node runs; all others are read-only."""
DEFAULT_LIDARS = ('left', 'right')
NOT_OURS = ('use_sim_time', 'start_type_description_service')
"""Parameters that rclpy itself declares."""


class NodeParameters:
    """Declares all settings on a node and keeps ``config`` up to date.

    ``given`` are those that somebody set, as nested dictionaries.

    The node must have been made with ``automatically_declare_parameters_from_overrides``: that is
    the public way to learn of names that nobody declares. Raises ConfigError for unknown names
    and for values that the schema refuses.
    """

    def __init__(self, node: Node) -> None:
        given = {
            name: parameter.value
            for name, parameter in node.get_parameters_by_prefix('').items()
            if name not in NOT_OURS and not name.startswith('qos_overrides.')
        }
        # rclpy only logs that it cannot use this one, and goes on with the system's time.
        sim_time = node.get_parameter('use_sim_time').value
        if not isinstance(sim_time, bool):
            raise ConfigError(f'parameters: use_sim_time is {sim_time!r}; it must be true or false')
        self.given = nested(given)
        self.config = _config(given)
        for name in given:
            node.undeclare_parameter(name)
        for name, value, descriptor in declarations(self.config):
            node.declare_parameter(name, value, descriptor, ignore_override=True)
        self._warn = node.get_logger().warning
        self._look_at_folders(self.config.save.model_fields_set)
        node.add_on_set_parameters_callback(self._on_set)

    def _look_at_folders(self, names: Collection[str]) -> None:
        """Tell of folders of ``save`` that could not be made now, while it can be mended."""
        for name in ('folder', 'on_shutdown', 'fallback'):
            folder = str(getattr(self.config.save, name))
            why = obstacle(Path(folder)) if folder and name in names else ''
            if why:
                self._warn(f'save.{name}: {folder} could not be made now: {why}')

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = {item.name: item.value for item in parameters if item.name in CHANGEABLE}
        try:
            self.config = make_config(merge(to_tree(self.config), nested(changes)), 'parameters')
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._look_at_folders([name.removeprefix('save.') for name in changes])
        return SetParametersResult(successful=True)


def declarations(config: Config) -> Iterator[tuple[str, Any, ParameterDescriptor]]:
    """Name, value and descriptor of every parameter."""
    tree = to_tree(config)
    names = ParameterDescriptor(description='Names of the LiDARs.', read_only=True)
    yield 'lidars.names', tree['lidars']['names'], names
    for lidar in config.lidars:
        for name, info in LidarSensor.model_fields.items():
            place = f'lidars.{lidar}.{name}'
            yield place, tree['lidars'][lidar][name], _descriptor(place, info)
    for section, outer in Config.model_fields.items():
        model = outer.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            for name, info in model.model_fields.items():
                place = f'{section}.{name}'
                yield place, tree[section][name], _descriptor(place, info)


def nested(flat: Mapping[str, Any]) -> Tree:
    """Dotted names to a nested tree; raises ConfigError where a name is section and value."""
    tree: Tree = {}
    for name, value in flat.items():
        *sections, last = name.split('.')
        branch = tree
        for section in sections:
            branch = branch.setdefault(section, {})
            if not isinstance(branch, dict):
                raise ConfigError(f'parameters: {name} is no setting')
        # Arrays arrive as array.array, which the schema does not know.
        scalar = value is None or isinstance(value, bool | int | float | str)
        branch[last] = value if scalar else list(value)
    return tree


def _config(given: Mapping[str, Any]) -> Config:
    tree = nested(given)
    if not tree.get('lidars'):
        tree['lidars'] = {'names': list(DEFAULT_LIDARS)}
    config = make_config(tree, 'parameters')
    check_formats(config.map.formats)
    if not config.lidars:
        raise ConfigError('parameters: lidars.names is empty; name at least one LiDAR')
    clash = {'imu', 'gnss'} & config.lidars.keys()
    if clash:
        raise ConfigError(f'parameters: no LiDAR may be called {min(clash)!r}; choose another name')
    return config


def _descriptor(name: str, info: FieldInfo) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        name=name, description=info.description or '', read_only=name not in CHANGEABLE
    )
    low, high = 0.0, 0.0
    notes: list[str] = []
    for item in info.metadata:
        if isinstance(item, Ge | Gt):
            low = _number(item.ge if isinstance(item, Ge) else item.gt)
            notes += [f'greater than {low:g}'] if isinstance(item, Gt) else []
        elif isinstance(item, Le):
            high = _number(item.le)
    if high > low and info.annotation is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif high > low and info.annotation is int:
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    if isinstance(info.annotation, type) and issubclass(info.annotation, StrEnum):
        notes.append('one of ' + ', '.join(info.annotation))
    descriptor.additional_constraints = '; '.join(notes)
    return descriptor


def _number(bound: Any) -> float:
    return float(bound)
