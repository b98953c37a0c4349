"""What is answered, as objects: documents of the HTTP API with names, types and pictures."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Iterator, Mapping
from enum import IntEnum
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Bounds",
    "Change",
    "Contained",
    "EdgeLength",
    "Exact",
    "FixedPoint",
    "History",
    "MassProperties",
    "Measures",
    "Side",
    "Vertices",
]

Vector = tuple[float, float, float]


class EdgeLength(NamedTuple):
    """Lengths of edges by kind. Units: user units, or lattice steps where they are exact."""

    total: float
    convex: float
    """Where less than half of the space around is filled."""
    concave: float
    """Where more is filled."""
    crossing: float
    """Where two solids meet along an edge."""


class Vertices(NamedTuple):
    """Numbers of vertices by kind."""

    total: int
    corner: int
    """A cube's own corners."""
    edge_face: int
    """Where an edge goes through a face."""
    three_face: int
    """Where three faces meet."""
    degenerate: int
    """Where features coincide."""


class Bounds(NamedTuple):
    """An axis-aligned box. Units: user units."""

    min: Vector
    max: Vector


class FixedPoint(int):
    """An exact integer of a scene of solids: divided by `divisor` it is in lattice steps to their power."""

    divisor: int
    """What to divide it by."""
    error_max: int
    """How far rounding can be off, at most, in the integer's own unit."""

    def __new__(cls, value: int, divisor: int, error_max: int) -> FixedPoint:
        made = super().__new__(cls, value)
        made.divisor = divisor
        made.error_max = error_max
        return made

    def __reduce__(self) -> tuple[type[FixedPoint], tuple[int, int, int]]:
        return type(self), (int(self), self.divisor, self.error_max)

    @property
    def fraction(self) -> Fraction:
        """The value in lattice steps to their power."""
        return Fraction(int(self), self.divisor)


class Document:
    """An answer. Equal answers are equal; it can be pickled, and `to_dict` gives the JSON that it was made of."""

    __slots__ = ("_document", "_unit")

    def __init__(self, document: Mapping[str, Any], unit: str = "") -> None:
        self._document = dict(document)
        self._unit = unit

    def to_dict(self) -> dict[str, Any]:
        """The document as the HTTP API has it. Integers that may be long are decimal strings in it."""
        return dict(self._document)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Document) and type(other) is type(self) and self._document == other._document

    def __hash__(self) -> int:
        return hash(repr(sorted(self._document.items(), key=lambda item: item[0])))

    def __reduce__(self) -> tuple[type[Document], tuple[dict[str, Any], str]]:
        return type(self), (self._document, self._unit)

    def _rows(self) -> list[tuple[str, str]]:
        """What is shown, a name and a text each."""
        return [(name, str(value)) for name, value in self._document.items()]

    def __repr__(self) -> str:
        shown = ", ".join(f"{name} {text}" for name, text in self._rows())
        return f"<{type(self).__name__}: {shown}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
            f"<td style='text-align:left'>{html.escape(text)}</td></tr>"
            for name, text in self._rows()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


class Exact(Document):
    """The integers behind the measures, in lattice steps to their power, moments about the lattice's origin.

    Of a scene of solids each is a `FixedPoint`. They are a function of the set of bodies alone, and equal when that is: how far rounding
    can be off, which depends on what was there before, is not compared.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Exact) and self._values() == other._values()

    def __hash__(self) -> int:
        return hash(repr(sorted(self._values().items())))

    def _values(self) -> dict[str, Any]:
        def value(given: Any) -> Any:
            return (given["value"], given["divisor"]) if "error_max" in given else given

        return {name: value(given) for name, given in self._document.items()}

    @property
    def steps_per_unit(self) -> int:
        """Lattice steps in a user unit."""
        return int(self._document["steps_per_unit"])

    @property
    def volume(self) -> int:
        """Volume."""
        return self._one("volume")

    @property
    def area(self) -> int:
        """Area."""
        return self._one("area")

    @property
    def area_by_axis(self) -> tuple[int, ...]:
        """Area of the faces whose normal is along x, y, z. Of cubes only."""
        return self._several("area_by_axis")

    @property
    def edge_length(self) -> EdgeLength:
        """Lengths of edges by kind."""
        given = self._document["edge_length"]
        if "total" in given:
            return EdgeLength(*(int(given[kind]) for kind in EdgeLength._fields))
        kinds = self._several("edge_length")
        divisor, error_max = int(given["divisor"]), int(given["error_max"])
        return EdgeLength(FixedPoint(sum(kinds), divisor, 3 * error_max), *kinds)

    @property
    def first_moments2(self) -> tuple[int, ...]:
        """Twice the integrals of x, y, z. Of cubes only."""
        return self._several("first_moments2")

    @property
    def second_moments3(self) -> tuple[int, ...]:
        """Three times the integrals of x², y², z². Of cubes only."""
        return self._several("second_moments3")

    @property
    def product_moments4(self) -> tuple[int, ...]:
        """Four times the integrals of xy, yz, zx. Of cubes only."""
        return self._several("product_moments4")

    @property
    def first_moments(self) -> tuple[int, ...]:
        """Integrals of x, y, z. Of solids only."""
        return self._several("first_moments")

    @property
    def second_moments(self) -> tuple[int, ...]:
        """Integrals of x², y², z², xy, yz, zx. Of solids only."""
        return self._several("second_moments")

    def _one(self, name: str) -> int:
        given = self._document[name]
        if isinstance(given, str):
            return int(given)
        return FixedPoint(int(given["value"]), int(given["divisor"]), int(given["error_max"]))

    def _several(self, name: str) -> tuple[int, ...]:
        if name not in self._document:
            raise AttributeError(f"a scene of this kind has no {name}")
        given: Any = self._document[name]
        if "divisor" not in given:
            return tuple(int(value) for value in given)
        divisor, error_max = int(given["divisor"]), int(given["error_max"])
        return tuple(FixedPoint(int(value), divisor, error_max) for value in given["value"])


class Measures(Document):
    """What is measured of a union, or of a part of the stock."""

    __slots__ = ()

    @property
    def volume(self) -> float:
        """Volume. Units: user units cubed."""
        return float(self._document["volume"])

    @property
    def area(self) -> float:
        """Area of the surface. Units: user units squared."""
        return float(self._document["area"])

    @property
    def edge_length(self) -> EdgeLength:
        """Lengths of edges. Units: user units."""
        given = self._document["edge_length"]
        return EdgeLength(*(float(given[kind]) for kind in EdgeLength._fields))

    @property
    def mass(self) -> float:
        """Density times volume."""
        return float(self._document["mass"])

    @property
    def centroid(self) -> NDArray[np.float64] | None:
        """Centre of mass; ``None`` when there is no volume. Units: user units. Shape: (3,)"""
        given = self._document["centroid"]
        return None if given is None else np.array(given, dtype=np.float64)

    @property
    def inertia(self) -> NDArray[np.float64]:
        """Inertia tensor about the centroid. Units: mass times user units squared. Shape: (3, 3)"""
        return np.array(self._document["inertia"], dtype=np.float64)

    @property
    def mean_curvature(self) -> float:
        """Integral of the mean curvature. Units: user units. Of cubes only."""
        return float(self._of_cubes("mean_curvature"))

    @property
    def euler_characteristic(self) -> int:
        """Pieces minus tunnels plus cavities of the closed set. Of cubes only."""
        return int(self._of_cubes("euler_characteristic"))

    @property
    def vertices(self) -> Vertices:
        """Numbers of vertices by kind. Of cubes only."""
        given = self._of_cubes("vertices")
        return Vertices(*(int(given[kind]) for kind in Vertices._fields))

    @property
    def error_max(self) -> dict[str, float]:
        """How far rounding can be off, at most, by measure, in its user units. Of solids only: cubes are exact."""
        if "error_max" not in self._document:
            raise AttributeError("measures of cubes have no error_max: they are exact")
        return {name: float(value) for name, value in self._document["error_max"].items()}

    @property
    def exact(self) -> Exact:
        """The integers behind the measures."""
        return Exact(self._document["exact"])

    def _of_cubes(self, name: str) -> Any:
        if name not in self._document:
            raise AttributeError(f"{name} is not measured of solids")
        return self._document[name]

    def _rows(self) -> list[tuple[str, str]]:
        unit = self._unit
        rows = [
            ("volume", f"{self.volume:.9g} {unit}³"),
            ("area", f"{self.area:.9g} {unit}²"),
            ("edge length", f"{self.edge_length.total:.9g} {unit}"),
        ]
        if (centroid := self._document["centroid"]) is not None:
            rows.append(("centroid", f"({_numbers(centroid)}) {unit}"))
        if "euler_characteristic" in self._document:
            rows.append(("Euler characteristic", str(self.euler_characteristic)))
        return rows


class MassProperties(Measures):
    """The mass properties of a scene after one change.

    Of a scene of solids with a stock they are those of what the solids remove from it.
    """

    __slots__ = ()

    @property
    def seq(self) -> int | None:
        """Number of the change that they are as of; ``None`` of a dry run and of a file."""
        given = self._document["seq"]
        return None if given is None else int(given)

    @property
    def bodies(self) -> int:
        """Number of cubes or solids; two at one place count twice."""
        return int(self._document["cubes" if "cubes" in self._document else "solids"])

    @property
    def bounds(self) -> Bounds | None:
        """The axis-aligned box around all bodies; ``None`` when there is none."""
        given = self._document["bounds"]
        return None if given is None else Bounds(tuple(given["min"]), tuple(given["max"]))

    @property
    def removed(self) -> Measures | None:
        """The union inside the stock; ``None`` where there is no stock."""
        return self._part("removed")

    @property
    def remaining(self) -> Measures | None:
        """The stock outside the union; ``None`` where there is no stock."""
        return self._part("remaining")

    def _part(self, name: str) -> Measures | None:
        given = self._document.get(name)
        return None if given is None else Measures(given, self._unit)

    def _rows(self) -> list[tuple[str, str]]:
        kind = "cubes" if "cubes" in self._document else "solids"
        rows = [(kind, f"{self.bodies:,}"), *super()._rows()]
        if (bounds := self.bounds) is not None:
            rows.append(("bounds", f"({_numbers(bounds.min)}) to ({_numbers(bounds.max)}) {self._unit}"))
        rows += [
            (name, f"{part.volume:.9g} {self._unit}³")
            for name, part in (("removed", self.removed), ("remaining", self.remaining))
            if part is not None
        ]
        return [("seq", str(self.seq)), *rows] if self.seq is not None else rows


class Change(Document):
    """What a change did, or what it would do; several changes, added up, where a call took more than one."""

    __slots__ = ()

    @property
    def seq(self) -> int:
        """Number of the scene's newest change: this one, unless it changed nothing."""
        return int(self._document["seq"])

    @property
    def inserted(self) -> int:
        """Bodies inserted."""
        return int(self._document["inserted"])

    @property
    def deleted(self) -> int:
        """Bodies deleted."""
        return int(self._document["deleted"])

    @property
    def unchanged(self) -> int:
        """Operations that changed nothing: a body that is there already, or one to delete that is not."""
        return int(self._document["unchanged"])

    @property
    def volume_removed(self) -> float:
        """Volume removed from the stock, or added to the union where there is no stock. Units: user units cubed."""
        return float(self._document["volume_removed"])

    @property
    def exact_volume_removed(self) -> int:
        """The same in lattice steps cubed; of a scene of solids in 96ths of them."""
        return int(self._document["volume_removed_exact"])

    @property
    def dry_run(self) -> bool:
        """Whether nothing was done: then the rest says what would be."""
        return bool(self._document.get("dry_run", False))

    @property
    def ids(self) -> NDArray[np.uint64]:
        """The ids that were given to bodies without one, in their order. Shape: (count,)"""
        ranges = self._document.get("assigned", [])
        spans = [np.arange(first, last + 1, dtype=np.uint64) for first, last in ranges]
        return np.concatenate(spans) if spans else np.empty(0, dtype=np.uint64)

    @property
    def mass_properties(self) -> MassProperties:
        """The mass properties after it. Of a dry run only; others are read from the scene."""
        if "mass_properties" not in self._document:
            raise AttributeError("read them from the scene: scene.mass_properties")
        return MassProperties(self._document["mass_properties"], self._unit)

    @classmethod
    def _of(cls, answers: list[dict[str, Any]], unit: str) -> Change:
        """The answers to one change or several, added up."""
        last = dict(answers[-1])
        for name in ("inserted", "deleted", "unchanged"):
            last[name] = sum(answer[name] for answer in answers)
        last["volume_removed"] = sum(answer["volume_removed"] for answer in answers)
        last["volume_removed_exact"] = str(sum(int(answer["volume_removed_exact"]) for answer in answers))
        given = [answer["assigned"] for answer in answers if "assigned" in answer]
        last["assigned"] = [(int(ids["first"]), int(ids["last"])) for ids in given]
        return cls(last, unit)

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("seq", str(self.seq))] if not self.dry_run else [("dry run", "nothing was done")]
        rows += [(name, f"{self._document[name]:,}") for name in ("inserted", "deleted", "unchanged")]
        return [*rows, ("volume removed", f"{self.volume_removed:.9g} {self._unit}³")]


class Side(IntEnum):
    """Where a point lies."""

    OUTSIDE = 0
    BOUNDARY = 1
    INSIDE = 2


class Contained(NamedTuple):
    """Where points lie, an entry for each."""

    side: NDArray[np.uint8]
    """As `Side` says. Shape: (count,)"""
    held: NDArray[np.bool_]
    """Whether some body holds the point, its faces included. Shape: (count,)"""
    id: NDArray[np.uint64]
    """The least id of a body that holds it; 0 where `held` is false. Shape: (count,)"""


class History(Mapping[str, NDArray[Any]]):
    """The totals after every change and what it did: columns by name, also as attributes, a row for each change.

    ``seq``, ``inserted``, ``deleted`` and ``cubes`` or ``solids`` are integers; ``time`` is datetime64 in UTC; ``move`` is
    masked where none was given; ``duration`` and ``removal_rate`` are NaN where they are not known; ``volume``, ``area``,
    ``edge_length``, ``volume_removed``, and with a stock ``removed`` and ``remaining`` are floats in user units; those that
    end in ``_exact`` are Python integers in lattice steps, and of solids in their fixed point.
    """

    __slots__ = ("_columns",)

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self._columns = dict(columns)

    @classmethod
    def _of(cls, text: str) -> History:
        names, *rows = csv.reader(io.StringIO(text))
        cells = {name: [row[index] for row in rows] for index, name in enumerate(names)}
        return cls({name: _column(name, texts) for name, texts in cells.items() if name == "move" or not _blank(texts)})

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._columns[name]

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_") or name not in self._columns:
            raise AttributeError(f"this history has no column {name}; it has {', '.join(self._columns)}")
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        """Number of columns; that of changes is ``history.seq.size``."""
        return len(self._columns)

    def __reduce__(self) -> tuple[type[History], tuple[dict[str, NDArray[Any]]]]:
        return type(self), (self._columns,)

    def __repr__(self) -> str:
        return f"<History: {self._columns['seq'].size:,} changes, columns {', '.join(self._columns)}>"

    def _repr_html_(self) -> str:
        shown_max = 20
        count = self._columns["seq"].size
        heads = "".join(f"<th>{html.escape(name)}</th>" for name in self._columns)
        rows = "".join(
            "<tr>" + "".join(f"<td>{html.escape(str(column[row]))}</td>" for column in self._columns.values()) + "</tr>"
            for row in range(max(0, count - shown_max), count)
        )
        caption = f"History: the last {min(count, shown_max)} of {count:,} changes"
        return f"<table><caption>{caption}</caption><tr>{heads}</tr>{rows}</table>"


def _blank(texts: list[str]) -> bool:
    return bool(texts) and not any(texts)


def _column(name: str, texts: list[str]) -> NDArray[Any]:
    """A column of CSV as an array."""
    if name == "time":
        return np.array([text.rstrip("Z") for text in texts], dtype="datetime64[ms]")
    if name == "move":
        absent = [not text for text in texts]
        values = np.array([int(text or 0) for text in texts], dtype=np.uint64)
        return np.ma.MaskedArray(values, mask=absent)
    if name.endswith("_exact"):
        exact = np.empty(len(texts), dtype=object)
        exact[:] = [int(text) for text in texts]
        return exact
    if name in ("seq", "inserted", "deleted", "cubes", "solids", "euler_characteristic"):
        return np.array([int(text) for text in texts], dtype=np.int64)
    return np.array([float(text) if text else np.nan for text in texts], dtype=np.float64)


def _numbers(values: Any) -> str:
    return ", ".join(f"{value:.9g}" for value in values)
