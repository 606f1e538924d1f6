"""The static transforms of a bag: how its frames hang together."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.sensor_places import BASE_FRAME, bad_transform, told_twice
from incremental_mapper.geometry import pose_matrix

Edge: TypeAlias = tuple[str, str]
"""Frames of a transform: parent and child."""

STATIC_TOPIC, MOVING_TOPIC = '/tf_static', '/tf'
MOST_MESSAGES = 2000
"""Messages of ``/tf`` that are looked at: 20 s at 100 Hz show what moves."""
_STILL = 1e-6
"""Largest change of a transform's numbers that is none."""


@dataclass(slots=True)
class FrameTree:
    """Transforms between frames.

    Attributes:
        edges: T_parent_child (4, 4) by parent and child.
        findings: transforms that could not be used.
        wanted: name of the car's frame, if it is there.
    """

    edges: dict[Edge, NDArray[np.float64]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    wanted: str = BASE_FRAME

    def base(self) -> str | None:
        """Name of the car's frame: the wanted one, or the only one that ends in ``base_link``."""
        names = {name for edge in self.edges for name in edge}
        if self.wanted in names:
            return self.wanted
        found = [name for name in sorted(names) if name.split('/')[-1] == BASE_FRAME]
        return BASE_FRAME if BASE_FRAME in found else found[0] if len(found) == 1 else None

    def root(self) -> str | None:
        """Name of the frame that all others hang on, None where there are several or none."""
        children = {child for _, child in self.edges}
        roots = {parent for parent, _ in self.edges} - children
        return roots.pop() if len(roots) == 1 else None

    def between(self, target: str, source: str) -> NDArray[np.float64] | None:
        """Follow the transforms from one frame to another.

        Args:
            target: frame that points are wanted in.
            source: frame that they are in.

        Returns:
            T_target_source (4, 4), or None where no chain joins the two.
        """
        found = {clean(target): np.eye(4)}
        waiting = deque(found)
        while waiting:
            here = waiting.popleft()
            for (parent, child), matrix in self.edges.items():
                if parent == here and child not in found:
                    found[child] = found[here] @ matrix
                    waiting.append(child)
                elif child == here and parent not in found:
                    found[parent] = found[here] @ np.linalg.inv(matrix)
                    waiting.append(parent)
        return found.get(clean(source))


def clean(frame: str) -> str:
    """A frame's name without the slash that tf had in front."""
    return frame.lstrip('/')


class StillTransforms:
    """Finds the transforms of ``/tf`` that do not move, as some publishers have all there."""

    def __init__(self) -> None:
        self._first: dict[Edge, NDArray[np.float64]] = {}
        self._again: set[Edge] = set()
        self._moving: set[Edge] = set()

    def take(self, edge: Edge, numbers: NDArray[np.float64]) -> None:
        """Look at a transform (x, y, z, qx, qy, qz, qw) between parent and child."""
        if edge not in self._first:
            self._first[edge] = numbers
            return
        self._again.add(edge)
        if not np.allclose(numbers, self._first[edge], rtol=0.0, atol=_STILL):
            self._moving.add(edge)

    def add_to(self, tree: FrameTree) -> None:
        """Add those that have come again and have not moved, where the tree has none."""
        # What was sent once may move still.
        for edge in sorted((self._again - self._moving) - tree.edges.keys()):
            add_transform(tree, MOVING_TOPIC, edge, self._first[edge])


def read_static_transforms(reader: AnyReader) -> FrameTree:
    """Read ``/tf_static``.

    Args:
        reader: an open bag.

    Returns:
        Its transforms, the newest of each pair of frames.
    """
    tree = FrameTree()
    for edge, numbers in _transforms(reader, STATIC_TOPIC, None):
        add_transform(tree, STATIC_TOPIC, edge, numbers)
    return tree


def add_still_transforms(reader: AnyReader, tree: FrameTree) -> None:
    """Add those of ``/tf`` that do not move, as some publishers have all transforms there.

    Args:
        reader: an open bag.
        tree: gets what it has not yet.
    """
    still = StillTransforms()
    for edge, numbers in _transforms(reader, MOVING_TOPIC, MOST_MESSAGES):
        still.take(edge, numbers)
    still.add_to(tree)


def stamped_transforms(message: Any) -> Iterator[tuple[Edge, NDArray[np.float64]]]:
    """Read ((parent, child), x y z qx qy qz qw) from a ``tf2_msgs/TFMessage``."""
    for stamped in message.transforms:
        place, turn = stamped.transform.translation, stamped.transform.rotation
        numbers = np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])
        yield (clean(stamped.header.frame_id), clean(stamped.child_frame_id)), numbers


def add_transform(tree: FrameTree, topic: str, edge: Edge, numbers: NDArray[np.float64]) -> None:
    """Add a transform to a tree, or a finding where it is none.

    Args:
        tree: gets the transform, in place of one between the same frames.
        topic: where it came from.
        edge: parent and child.
        numbers: x, y, z, qx, qy, qz, qw.
    """
    known = tree.edges.get(edge)
    try:
        tree.edges[edge] = pose_matrix(numbers.tolist())
    except ValueError as error:
        _tell(tree, [bad_transform(topic, edge[1], edge[0], str(error))])
        return
    if known is not None:
        _tell(tree, told_twice(topic, edge[1], edge[0], known, tree.edges[edge]))


def _tell(tree: FrameTree, found: Sequence[Finding]) -> None:
    """Add findings to a tree in place of their like: a publisher may say the same for hours."""
    new = {(one.rule, one.sensor) for one in found}
    kept = [one for one in tree.findings if (one.rule, one.sensor) not in new]
    tree.findings[:] = [*kept, *found]


def _transforms(
    reader: AnyReader, topic: str, most: int | None
) -> Iterator[tuple[Edge, NDArray[np.float64]]]:
    """The transforms of a topic, in the order in which they were logged."""
    connections = [c for c in reader.connections if c.topic.lstrip('/') == topic.lstrip('/')]
    if not connections:
        return
    for count, (connection, _, data) in enumerate(reader.messages(connections=connections)):
        if most is not None and count >= most:
            return
        try:
            yield from stamped_transforms(reader.deserialize(data, connection.msgtype))
        # Of a damaged message the decoder raises whatever it stumbles over.
        except Exception:
            continue
