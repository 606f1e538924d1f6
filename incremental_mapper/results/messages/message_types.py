"""Where the classes of messages come from: rclpy's, or those of the bag library."""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

Field = tuple[Nodetype, Any]
"""A field's kind and what it is made of, as the bag library tells it."""


class MessageTypes(Protocol):
    """Makes messages by the names of their types, such as ``nav_msgs/msg/Path``."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Make a message; what is not given is zero, empty or false."""
        ...

    def constant(self, name: str, constant: str) -> Any:
        """Read a constant of a type."""
        ...

    def blob(self, data: NDArray[np.uint8]) -> Any:
        """Bytes as a field takes them fastest."""
        ...


class BagTypes:
    """The types of ROS 2 Jazzy in the bag library; needs no ROS."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self._makers: dict[str, tuple[Any, dict[str, Callable[[], Any]]]] = {}

    def make(self, name: str, /, **fields: Any) -> Any:
        """Make a message; see ``MessageTypes``."""
        if name not in self._makers:
            defaults = {field: self._default(kind) for field, kind in self.store.fielddefs[name][1]}
            self._makers[name] = self.store.types[name], defaults
        kind, defaults = self._makers[name]
        missing = {field: make() for field, make in defaults.items() if field not in fields}
        return kind(**fields, **missing)

    def constant(self, name: str, constant: str) -> Any:
        """Read a constant; see ``MessageTypes``."""
        return getattr(self.store.types[name], constant)

    def blob(self, data: NDArray[np.uint8]) -> Any:
        """An array, as it is."""
        return data

    def _default(self, field: Field) -> Callable[[], Any]:
        """What makes the value of a field that is not given."""
        kind, what = field
        if kind is Nodetype.NAME:
            return partial(self.make, what)
        if kind is Nodetype.BASE:
            value: Any = '' if what[0] == 'string' else False if what[0] == 'bool' else 0
            return lambda: value
        (inner, details), length = what
        if inner is Nodetype.BASE and details[0] != 'string':
            return lambda: np.zeros(length, dtype=details[0])
        element = self._default((inner, details))
        return lambda: [element() for _ in range(length)]
