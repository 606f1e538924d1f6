"""What the user's settings say about the sensors of an input."""

from collections.abc import Mapping
from typing import Any

from incremental_mapper.config import Sensor
from incremental_mapper.measurements import NANOSECONDS


def listed_lidars(tree: Mapping[str, Any]) -> list[str] | None:
    """Read which LiDARs ``lidars.names`` lists; None where the settings leave the choice open."""
    lidars = tree.get('lidars')
    names = lidars.get('names') if isinstance(lidars, Mapping) else None
    return [str(name) for name in names] if isinstance(names, list) else None


def offset_nanoseconds(sensor: Sensor) -> int:
    """Tell what is added to every stamp of a sensor, in nanoseconds."""
    return round(sensor.time_offset * NANOSECONDS)
