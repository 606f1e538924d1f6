"""What the user's settings say about the sensors of an input."""

from collections.abc import Container, Mapping
from dataclasses import replace
from typing import Any

from incremental_mapper.config import Config, Sensor
from incremental_mapper.measurements import NANOSECONDS, Measurement


def listed_lidars(tree: Mapping[str, Any]) -> list[str] | None:
    """Read which LiDARs ``lidars.names`` lists; None where the settings leave the choice open."""
    lidars = tree.get('lidars')
    names = lidars.get('names') if isinstance(lidars, Mapping) else None
    return [str(name) for name in names] if isinstance(names, list) else None


def offset_nanoseconds(sensor: Sensor) -> int:
    """Tell what is added to every stamp of a sensor, in nanoseconds."""
    return round(sensor.time_offset * NANOSECONDS)


def with_settings(measurement: Measurement, config: Config) -> Measurement:
    """Put a measurement right as the settings say, where it was made without them.

    Args:
        measurement: With the stamp of its message, and its numbers.
        config: What is added to the stamp.

    Returns:
        The measurement, itself where there is nothing to do.
    """
    sensors = {'imu': config.imu, 'gnss': config.gnss}
    sensor = config.lidars.get(measurement.sensor) or sensors.get(measurement.sensor)
    offset = 0 if sensor is None else offset_nanoseconds(sensor)
    return replace(measurement, stamp=measurement.stamp + offset) if offset else measurement


def extrinsics_of(settings: Mapping[str, Any], name: str, lidars: Container[str]) -> Any:
    """T_base_sensor of a sensor as settings have it, or None where they say nothing of it.

    Args:
        settings: nested dictionaries.
        name: the sensor.
        lidars: names of all LiDARs.
    """
    owner = settings.get('lidars', {}) if name in lidars else settings
    section = owner.get(name, {}) if isinstance(owner, Mapping) else {}
    return section.get('T_base_sensor') if isinstance(section, Mapping) else None
