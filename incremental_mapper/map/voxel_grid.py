"""Mean points of voxels, for many points at a time: a hash table, compiled.

``voxels`` does it for one scan in the LiDARs' processes, which start the sooner without a compiler.
"""

from collections.abc import Iterable
from math import floor

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel
from incremental_mapper.map.near_voxels import STRETCH, enclose, means_near
from incremental_mapper.map.shared_rows import SHARED, SharedRows, shared_zeros

FURTHEST = 2.0e9
"""Voxels from the corner beyond which 32 bits do not tell them apart."""
UNMARKED = np.empty(0, dtype=np.int32)
"""The marks of points of which nobody keeps any."""
ROOM = 1024
"""Voxels for which a grid has room when nothing is said."""
GROWTH = 16
"""Room grows by one part in so many, since fresh memory costs as much as what is done with it."""
TOUCHED = 1 << 17
"""Slots of the next table that are written for the first time with each cloud, before any voxel
enters it: where voxels do that, each of them waits for a page of memory."""
PARTS = 4
"""For each point that is added, so many voxels enter the next table."""
FULLEST = 0.75
"""Share of a table's slots that are taken at the most; more are asked in vain for one point."""


class VoxelGrid:
    """Voxels with the mean of the points in each; takes points at any time.

    Adding costs as much as what is added, and never much more: with a million voxels a table that
    doubles at once took a fifth of a second, for which a vehicle's pose waited. So the next table
    is filled a part at a time, while the one before it is used. A voxel takes 32 bytes, and 8 to 16
    in the table, with intensity and without; for a while there are two.

    A voxel's intensity is the mean of those of its points that have one; a point without takes the
    mean so far, so that one number holds it all. It is NaN where no point has any.

    A grid that is told so also keeps the mark of each voxel's first point: four bytes more.
    """

    def __init__(
        self,
        voxel_size: float,
        corner: NDArray[np.float64] | None = None,
        max_range: float = np.inf,
        fullest: float = np.inf,
        room: int = ROOM,
        marked: bool = False,
        shared: bool = False,
    ) -> None:
        """Make an empty grid.

        Args:
            voxel_size: side of a voxel, metres.
            corner: where a corner of a voxel lies, (3,), metres in the map; its origin if None.
            max_range: points further than this many metres from the origin of their own frame are
                left out.
            fullest: points after which a voxel takes no more. Sums are single precision, so a
                grid that points are added to for hours needs a limit.
            room: voxels that are expected; more make the grid grow.
            marked: whether it keeps marks.
            shared: whether forks share its memory, see ``shared_rows``; they must not look at it.
        """
        self._size = voxel_size
        self._corner = np.zeros(3) if corner is None else corner
        self._limits = (max_range * max_range, voxel_size, float(fullest))
        self._used = self._boxed = 0
        self._columns = 3
        self._marked = marked
        self._rows = SharedRows(8) if shared and SHARED else None
        self._boxes = np.empty((0, 4), dtype=np.int32)
        self._make(max(room, 1))

    def add(
        self,
        points: NDArray[np.floating],
        transform: NDArray[np.float64],
        marks: NDArray[np.int32] = UNMARKED,
    ) -> None:
        """Add points (N, 3), metres, that ``transform`` (4, 4), T_map_points, places.

        Points that are not finite are left out. Where they are (N, 4), the last column is their
        intensity, NaN for those that have none; what is taken out has four columns from then on.
        A grid that keeps marks wants one, (N,), for each of them.
        """
        columns = np.require(points, np.float32, ('C', 'W'))  # one kind to compile for
        if self._marked and len(marks) != len(columns):
            raise ValueError(f'{len(marks)} marks for {len(columns)} points')
        self._columns = max(self._columns, columns.shape[1])
        self._reserve(len(columns))
        sums = self._cells.view(np.float32)
        rows = transform[:3].copy()
        cells, kept = (self._cells, sums), (marks, self._marks)
        self._used = _add(
            columns, rows, self._corner, self._limits, self._table, cells, kept, self._used
        )

    def points(self, without: 'VoxelGrid | None' = None) -> NDArray[np.float32]:
        """Mean points (M, 3), metres in the map, in the order of the voxels' first points.

        They are (M, 4), intensity last, once any of the points had one. Voxels that ``without`` has
        too are left out; it has the same corner and size.
        """
        cells = self._cells[: self._used]
        if without is not None:
            cells = cells[_absent(cells, without._table, without._cells)]
        sums = cells.view(np.float32)
        return _means(cells, sums, self._corner, self._size, self._columns)

    def marks(self) -> NDArray[np.int32]:
        """The marks (M,) of ``points``; none where the grid keeps none."""
        return self._marks[: self._used].copy()

    def __len__(self) -> int:
        return self._used

    def near(self, centre: NDArray[np.float64], radius: float, most: int) -> NDArray[np.float32]:
        """Mean points (M, 3 or 4) as ``points``, of voxels around a place in the plane.

        The cost is that of what lies around: stretches of voxels that came one after the other,
        as those of a drive do, are passed over as a whole where they are far off.

        Args:
            centre: x, y, metres in the map; further numbers are not looked at.
            radius: metres in the plane beyond which voxels are left out; infinity for no limit.
            most: upper limit of their number; where there are more, the nearest are taken.
        """
        self._box_up()
        return means_near(
            self._cells[: self._used],
            self._boxes[: self._boxed],
            (centre[:2] - self._corner[:2]) / self._size,
            radius / self._size,
            most,
            self._corner,
            self._size,
            self._columns,
        )

    def _box_up(self) -> None:
        """Note the extent of the stretches that are full and not noted yet: voxels never move."""
        full = self._used // STRETCH
        if full > len(self._boxes):
            grown = np.empty((2 * full, 4), dtype=np.int32)
            grown[: self._boxed] = self._boxes[: self._boxed]
            self._boxes = grown
        if full > self._boxed:
            enclose(self._cells[: self._used], self._boxes, self._boxed, full)
            self._boxed = full

    @property
    def nbytes(self) -> int:
        """Memory that the voxels take; what is kept free for more is not counted."""
        coming = 0 if self._next is None else self._next.nbytes
        return self._table.nbytes + coming + self._cells[: self._used].nbytes

    def _make(self, room: int) -> None:
        self._table = self._new_table(room)
        self._next: NDArray[np.int32] | None = None
        self._entered = self._touched = 0  # of the voxels and the slots, in the next table
        # A voxel's numbers lie side by side: what takes time is fetching them from memory.
        self._cells = np.empty((room, 8), dtype=np.int32)
        if self._rows is not None:
            self._share(self._rows, room)
        self._marks = np.empty(room if self._marked else 0, dtype=np.int32)

    def _share(self, rows: SharedRows, room: int) -> None:
        """Take so many cells in memory that forks share, or else in memory that they copy."""
        self._cells = np.empty((0, 8), dtype=np.int32)
        if rows.grow(room):
            self._cells = rows.rows()
            return
        self._rows, before = None, rows.rows()
        self._cells = np.empty((room, 8), dtype=np.int32)
        self._cells[: len(before)] = before

    def _new_table(self, room: int) -> NDArray[np.int32]:
        """A table where half of the slots or more stay free with so many voxels; 0 is a free one.

        Zeros take no memory before they are written.
        """
        slots = 1 << (2 * room - 1).bit_length()
        return np.zeros(slots, dtype=np.int32) if self._rows is None else shared_zeros(slots)

    def _reserve(self, more: int) -> None:
        """Make room for so many more voxels."""
        wanted = self._used + more
        if wanted > len(self._cells):
            room = max(wanted, len(self._cells) + len(self._cells) // GROWTH)
            # The system moves such a piece of memory without copying it. Nobody else holds it:
            # what is taken out is a copy.
            if self._rows is None:
                self._cells.resize((room, 8), refcheck=False)
            else:
                self._share(self._rows, room)
            if self._marked:
                self._marks.resize(room, refcheck=False)
        while self._next is not None or 2 * wanted > len(self._table):
            if self._next is None:
                self._next = self._new_table(max(wanted, len(self._table)))
                self._entered = self._touched = 0
            # All at once where there is no time: the table would be full.
            soon = wanted > FULLEST * len(self._table)
            if self._touched < len(self._next) and not soon:
                self._next[self._touched : self._touched + TOUCHED] = 0
                self._touched += TOUCHED
                break
            end = self._used if soon else min(self._entered + PARTS * more, self._used)
            _enter(self._cells[self._entered : end], self._entered, self._next)
            self._entered = end
            if end < self._used:
                break
            self._table, self._next = self._next, None


def mean_points(
    placed: Iterable[tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int32]]],
    most: int,
    corner: NDArray[np.float64],
    voxel_size: float,
    max_range: float = np.inf,
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """One mean point per voxel of points that are all at hand.

    Args:
        placed: points (N, 3 or 4), the transform (4, 4) that places them, and their marks (N,),
            see ``VoxelGrid.add``.
        most: points in all, or a few more.
        corner: where a corner of a voxel lies, (3,), metres.
        voxel_size: side of a voxel, metres.
        max_range: see ``VoxelGrid``.

    Returns:
        Points (M, 3 or 4), metres, in the order of the voxels' first points, and the marks (M,)
        of those.
    """
    grid = VoxelGrid(voxel_size, corner, max_range, room=most, marked=True)
    for points, transform, marks in placed:
        grid.add(points, transform, marks)
    return grid.points(), grid.marks()


def warm_up() -> None:
    """Compile or load what a growing grid needs."""
    grid = VoxelGrid(1.0, room=1)
    for _ in range(2):
        grid.add(np.ones((2, 3), dtype=np.float32), np.eye(4))
    grid.points(without=grid)
    grid.near(np.zeros(2), 1.0, 1)
    grid.near(np.zeros(2), np.inf, 1)


@kernel
def _means(
    cells: NDArray[np.int32],
    sums: NDArray[np.float32],
    corner: NDArray[np.float64],
    size: float,
    columns: int,
) -> NDArray[np.float32]:
    """Mean points (M, 3) of voxels, see _add; with four ``columns`` the last is the intensity."""
    means = np.empty((len(cells), columns), dtype=np.float32)
    for i in range(len(cells)):
        for k in range(3):
            means[i, k] = corner[k] + size * cells[i, k] + sums[i, 4 + k] / sums[i, 7]
        if columns == 4:
            means[i, 3] = sums[i, 3] / sums[i, 7]
    return means


@kernel
def _mixed(p: np.int32, q: np.int32, r: np.int32) -> np.uint64:
    """Where a voxel is looked for first, before the table's size is known.

    Neighbours end up far from each other: odd factors, and the upper bits count.
    """
    mixed = np.uint64(p) * np.uint64(0x9E3779B97F4A7C15)
    mixed += np.uint64(q) * np.uint64(0xC2B2AE3D27D4EB4F)
    mixed += np.uint64(r) * np.uint64(0x165667B19E3779F9)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
    return mixed >> np.uint64(32)


@kernel
def _enter(cells: NDArray[np.int32], first: int, table: NDArray[np.int32]) -> None:
    """Note in a table, which has none of them, where ``cells`` (M, 8) stand, from ``first`` on."""
    mask = np.uint64(len(table) - 1)
    for place in range(len(cells)):
        slot = _mixed(cells[place, 0], cells[place, 1], cells[place, 2]) & mask
        while table[slot] > 0:
            slot = (slot + np.uint64(1)) & mask
        table[slot] = first + place + 1


@kernel
def _absent(
    cells: NDArray[np.int32], table: NDArray[np.int32], others: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Which of ``cells`` (M, 8) are not among ``others`` (K, 8), of which ``table`` is, (M,)."""
    mask = np.uint64(len(table) - 1)
    absent = np.ones(len(cells), dtype=np.bool_)
    for i in range(len(cells)):
        p, q, r = cells[i, 0], cells[i, 1], cells[i, 2]
        slot = _mixed(p, q, r) & mask
        while table[slot] > 0:
            place = table[slot] - 1
            if others[place, 0] == p and others[place, 1] == q and others[place, 2] == r:
                absent[i] = False
                break
            slot = (slot + np.uint64(1)) & mask
    return absent


@kernel
def _add(
    points: NDArray[np.float32],
    transform: NDArray[np.float64],
    corner: NDArray[np.float64],
    limits: tuple[float, float, float],
    table: NDArray[np.int32],
    kept: tuple[NDArray[np.int32], NDArray[np.float32]],
    marked: tuple[NDArray[np.int32], NDArray[np.int32]],
    used: int,
) -> int:
    """Add ``points`` (N, 3 or 4) to the sums of their voxels.

    ``limits`` are the square of the range, the size of a voxel, and the points after which a
    voxel takes no more. ``kept`` are ``cells`` and ``sums``: ``cells`` (M, 8) begin with the place
    of a voxel in the grid; ``sums`` (M, 8), the same memory, go on with the sum of its points'
    intensities, NaN as long as none has any, and end with the sum of its points, from its own
    corner, and their number. ``table`` says where a voxel stands, counted from 1, 0 for nowhere;
    ``used`` of them are taken, and how many there are afterwards is returned. ``marked`` are the
    marks of the points and of the voxels, both empty where nobody wants them.
    """
    (cells, sums), (own_marks, marks) = kept, marked
    mask = np.uint64(len(table) - 1)
    t, (furthest, size, fullest) = transform, limits
    scale = 1.0 / size
    bright, unknown, one = points.shape[1] == 4, np.float32(np.nan), np.float32(1.0)
    for i in range(len(points)):
        u, v, w = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        x = t[0, 0] * u + t[0, 1] * v + t[0, 2] * w + (t[0, 3] - corner[0])
        y = t[1, 0] * u + t[1, 1] * v + t[1, 2] * w + (t[1, 3] - corner[1])
        z = t[2, 0] * u + t[2, 1] * v + t[2, 2] * w + (t[2, 3] - corner[2])
        a, b, c = floor(x * scale), floor(y * scale), floor(z * scale)
        within = u * u + v * v + w * w <= furthest
        if not (within and abs(a) + abs(b) + abs(c) < FURTHEST):  # NaN is not
            continue
        p, q, r = np.int32(a), np.int32(b), np.int32(c)
        slot = _mixed(p, q, r) & mask
        while True:
            place = table[slot] - 1
            if place < 0:
                place = used
                table[slot] = place + 1
                cells[place, 0], cells[place, 1], cells[place, 2] = p, q, r
                sums[place, 3] = np.nan
                for k in range(4, 8):
                    sums[place, k] = 0.0
                if len(marks) > 0:
                    marks[place] = own_marks[i]
                used += 1
                break
            if cells[place, 0] == p and cells[place, 1] == q and cells[place, 2] == r:
                break
            slot = (slot + np.uint64(1)) & mask
        if sums[place, 7] >= fullest:
            continue
        sums[place, 4] += x - a * size
        sums[place, 5] += y - b * size
        sums[place, 6] += z - c * size
        light, number = sums[place, 3], sums[place, 7]
        own = points[i, 3] if bright else unknown
        if own == own:  # it has one, and stands for those before it that had none
            sums[place, 3] = light + own if light == light else own * (number + one)
        elif light == light:
            sums[place, 3] = light + light / number
        sums[place, 7] = number + one
    return used
