"""Results as messages of rclpy."""

import array
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.results.messages.result_messages import ResultMessages


class RclpyTypes:
    """The types of the installed message packages; see ``MessageTypes``."""

    def make(self, name: str, /, **fields: Any) -> Any:
        """Make a message; what is not given has its default."""
        return message_class(name)(**fields)

    def constant(self, name: str, constant: str) -> Any:
        """Read a constant of a type."""
        return getattr(message_class(name), constant)

    def blob(self, data: NDArray[np.uint8]) -> Any:
        """Bytes that rclpy copies as a block; anything else it copies element by element."""
        block = array.array('B')
        block.frombytes(data.data)
        return block


@cache
def message_class(name: str) -> Any:
    """The class of a message such as ``nav_msgs/msg/Path``."""
    package, _, kind = name.split('/')
    return getattr(import_module(f'{package}.msg'), kind)


MESSAGES = ResultMessages(RclpyTypes())
"""Makes the messages that the node publishes."""
