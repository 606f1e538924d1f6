"""Connectivity by union-find, decided before anything is solved (paper, step 5)."""

from collections.abc import Hashable, Iterable
from typing import Generic, TypeVar

Node = TypeVar('Node', bound=Hashable)


class UnionFind(Generic[Node]):
    """Disjoint sets of hashable nodes; nodes come into being when they are first named."""

    def __init__(self, nodes: Iterable[Node] = ()) -> None:
        self._parent: dict[Node, Node] = {node: node for node in nodes}
        self._sets = len(self._parent)

    def find(self, node: Node) -> Node:
        """Representative of the node's set."""
        if node not in self._parent:
            self._parent[node] = node
            self._sets += 1
        root = node
        while self._parent[root] != root:
            root = self._parent[root]
        while self._parent[node] != root:
            self._parent[node], node = root, self._parent[node]
        return root

    def union(self, first: Node, second: Node) -> None:
        """Join the sets of two nodes."""
        one, other = self.find(first), self.find(second)
        if one != other:
            self._parent[one] = other
            self._sets -= 1

    @property
    def sets(self) -> int:
        """Number of disjoint sets."""
        return self._sets
