"""Bodies on their way into a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import Positions, ids_of, positions_of, same_count
from ._errors import invalid

Cubes = tuple[ArrayLike | range | None, ArrayLike]
"""Ids and corners, as `Scene.insert` takes them."""

Sweeps = tuple[ArrayLike | range | None, str | Sequence[str], ArrayLike, ArrayLike | None]
"""Ids, shapes, start and end, as `Scene.insert_sweeps` takes them."""

Hulls = tuple[ArrayLike | range | None, Sequence[ArrayLike]]
"""Ids and points, as `Scene.insert_hulls` takes them."""


@dataclass
class Insertion:
    """Bodies on their way in, of either kind; ids are all there or all left out."""

    ids: list[NDArray[np.uint64]] = field(default_factory=list[NDArray[np.uint64]])
    shapes: list[str] = field(default_factory=list[str])
    """The shape of each row of solids."""
    start: list[Positions] = field(default_factory=list[Positions])
    """Corners of cubes; or where shapes are carried from."""
    end: list[Positions] = field(default_factory=list[Positions])
    hull_ids: list[NDArray[np.uint64]] = field(default_factory=list[NDArray[np.uint64]])
    hulls: list[Positions] = field(default_factory=list[Positions])

    def add_cubes(self, ids: ArrayLike | range | None, corners: ArrayLike) -> None:
        named, places = None if ids is None else ids_of(ids), positions_of(corners)
        same_count(named, places)
        self.ids += [] if named is None else [named]
        self.start.append(places)

    def add_sweeps(
        self, ids: ArrayLike | range | None, shape: str | Sequence[str], start: ArrayLike, end: ArrayLike | None
    ) -> None:
        named, begin = None if ids is None else ids_of(ids), positions_of(start, "start")
        finish = begin if end is None else positions_of(end, "end")
        same_count(named, begin, "start")
        names = [shape] * len(begin) if isinstance(shape, str) else list(shape)
        if len(names) != len(begin):
            raise invalid("shape", f"has {len(names):,} entries, and start has {len(begin):,}")
        if len(finish) != len(begin):
            raise invalid("end", f"has {len(finish):,} entries, and start has {len(begin):,}")
        self.ids += [] if named is None else [named]
        self.shapes += names
        self.start.append(begin)
        self.end.append(finish)

    def add_hulls(self, ids: ArrayLike | range | None, hulls: Sequence[ArrayLike]) -> None:
        named = None if ids is None else ids_of(ids)
        points = [positions_of(hull, f"hulls[{index}]") for index, hull in enumerate(hulls)]
        if named is not None and len(named) != len(points):
            raise invalid("ids", f"has {len(named):,} entries, and hulls has {len(points):,}")
        self.hull_ids += [] if named is None else [named]
        self.hulls += points

    def leave_out(self, gone: NDArray[np.uint64]) -> None:
        """Takes out what has one of these ids."""
        for index, named in enumerate(self.ids):
            stay = ~np.isin(named, gone)
            before = sum(len(rows) for rows in self.start[:index])
            if self.shapes:
                kept = [name for name, keep in zip(self.shapes[before : before + len(named)], stay, strict=True) if keep]
                self.shapes[before : before + len(named)] = kept
                self.end[index] = self.end[index][stay]
            self.ids[index], self.start[index] = named[stay], self.start[index][stay]
        if self.hull_ids:
            named = np.concatenate(self.hull_ids)
            stay = ~np.isin(named, gone)
            self.hull_ids = [named[stay]]
            self.hulls = [hull for hull, keep in zip(self.hulls, stay, strict=True) if keep]

    def all_ids(self) -> NDArray[np.uint64] | None:
        ids = [*self.ids, *self.hull_ids]
        count = sum(len(named) for named in ids)
        bodies = sum(len(rows) for rows in self.start) + len(self.hulls)
        if not ids:
            return None
        if count != bodies:
            raise invalid("ids", "are given for some bodies and not for others: give them for all or for none")
        return ids[0] if len(ids) == 1 else np.concatenate(ids)


def joined(rows: list[Positions], name: str) -> Positions | None:
    """Rows as one array."""
    some = [part for part in rows if len(part)]
    if len(some) <= 1:
        return some[0] if some else None
    if len({part.dtype for part in some}) > 1:
        raise invalid(name, "are in user units and in lattice steps: one change takes one of them")
    whole: Any = np.concatenate(some)
    return cast(Positions, whole)
