"""Many marks and lines of a picture, gathered by their style and drawn at once.

An artist for each takes ten times as long, and a graph has hundreds of them.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Spot: TypeAlias = tuple[float, float]
Style: TypeAlias = tuple[tuple[str, Any], ...]


class Strokes:
    """Marks, lines and arcs by style; those of one style lie in the order in which they came.

    Styles are those of matplotlib's lines, for arcs those of its patches.
    """

    def __init__(self) -> None:
        self._marks: dict[Style, list[Spot]] = {}
        self._lines: dict[Style, list[Spot]] = {}
        self._arcs: dict[Style, list[Sequence[Spot]]] = {}

    def mark(self, spot: Spot, **style: Any) -> None:
        """Put a mark at a place."""
        self._marks.setdefault(tuple(style.items()), []).append(spot)

    def line(self, spots: Sequence[Spot], **style: Any) -> None:
        """Draw a line through places."""
        line = self._lines.setdefault(tuple(style.items()), [])
        line += [*spots, (np.nan, np.nan)]  # where it is lifted

    def arc(self, spots: Sequence[Spot], **style: Any) -> None:
        """Draw a cubic curve: where it starts, its two control points, where it ends."""
        self._arcs.setdefault(tuple(style.items()), []).append(spots)

    def draw(self, axes: 'Axes') -> None:
        """Draw all of it."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Curve

        for style, spots in self._lines.items():
            axes.plot(*np.array(spots).T, **dict(style))
        for style, spots in self._marks.items():
            axes.plot(*np.array(spots).T, linestyle='', **dict(style))
        for style, arcs in self._arcs.items():
            codes = [Curve.MOVETO, Curve.CURVE4, Curve.CURVE4, Curve.CURVE4] * len(arcs)
            curve = Curve(np.concatenate(arcs), codes)
            axes.add_patch(PathPatch(curve, facecolor='none', **dict(style)))
