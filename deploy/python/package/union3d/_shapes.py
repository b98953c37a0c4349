"""Shapes that solids of a scene share, and stocks: what `Scene` takes as ``shapes`` and ``stock``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ._arrays import positions_of
from ._documents import Document
from ._errors import invalid

__all__ = ["Shape", "ball", "box", "bull", "cylinder", "drill", "flat", "hull", "parts", "tapered", "vee"]

Polygon = Literal["equal_area", "inscribed", "circumscribed"]
"""Which polygon stands for a circle."""


class Shape(Document):
    """What is carried along the path of a solid, or a block of material; lengths in user units.

    Its origin is the anchor: of a cutter the centre of its tip. ``to_dict()`` is its document in the HTTP API.
    """

    __slots__ = ()

    def with_top(self, top: float) -> Shape:
        """The same, extended up to this height of the scene wherever it is carried: shanks that stick out end in one plane."""
        return Shape({**self._document, "top": float(top)})


def flat(
    diameter: float, length: float, *, sides: int = 32, polygon: Polygon = "equal_area", at: ArrayLike | None = None
) -> Shape:
    """A flat end mill, whose shank ends ``length`` above its tip.

    Args:
        diameter: Of the shank, a whole number of lattice steps.
        length: Height of the shank's top above the tip, a whole number of lattice steps.
        sides: Sides of the polygon that stands for a circle, 3 to 1024.
        polygon: The regular one of the circle's area, one inside the circle, or one around it.
        at: Where the centre of its tip is, seen from the anchor. (3,)
    """
    return _cutter("flat", diameter, length, sides, polygon, at)


def ball(
    diameter: float,
    length: float,
    *,
    rings: int | None = None,
    sides: int = 32,
    polygon: Polygon = "equal_area",
    at: ArrayLike | None = None,
) -> Shape:
    """A ball end mill; ``rings`` of its round end, 2 to 64. The rest as of `flat`."""
    return _cutter("ball", diameter, length, sides, polygon, at, rings=rings)


def bull(
    diameter: float,
    length: float,
    corner_radius: float,
    *,
    rings: int | None = None,
    sides: int = 32,
    polygon: Polygon = "equal_area",
    at: ArrayLike | None = None,
) -> Shape:
    """A bull-nose end mill: flat with a rounded corner. The rest as of `ball`."""
    return _cutter("bull", diameter, length, sides, polygon, at, corner_radius=corner_radius, rings=rings)


def vee(
    diameter: float,
    length: float,
    angle: float,
    *,
    tip: float | None = None,
    sides: int = 32,
    polygon: Polygon = "equal_area",
    at: ArrayLike | None = None,
) -> Shape:
    """A V-shaped cutter with the whole ``angle`` between its sides, in degrees, and a flat ``tip`` of this diameter. The rest as of `flat`."""
    return _cutter("vee", diameter, length, sides, polygon, at, angle=angle, tip=tip)


def drill(
    diameter: float,
    length: float,
    *,
    angle: float | None = None,
    sides: int = 32,
    polygon: Polygon = "equal_area",
    at: ArrayLike | None = None,
) -> Shape:
    """A drill with the whole point ``angle`` in degrees, 118 unless said. The rest as of `flat`."""
    return _cutter("drill", diameter, length, sides, polygon, at, angle=angle)


def tapered(
    diameter: float,
    length: float,
    angle: float,
    tip: float,
    *,
    sides: int = 32,
    polygon: Polygon = "equal_area",
    at: ArrayLike | None = None,
) -> Shape:
    """A tapered end mill: diameter of its flat ``tip``, and ``angle`` between its axis and its side in degrees. The rest as of `flat`."""
    return _cutter("tapered", diameter, length, sides, polygon, at, angle=angle, tip=tip)


def box(low: ArrayLike, high: ArrayLike) -> Shape:
    """An axis-aligned box from its least to its greatest corner, (3,) each. Of a shape they are seen from its anchor; of a stock in the scene."""
    return Shape({"box": {"min": _vector("low", low), "max": _vector("high", high)}})


def hull(points: ArrayLike) -> Shape:
    """The convex hull of points, (count, 3)."""
    rows = positions_of(points, "points")
    if rows.dtype.kind != "f":
        raise invalid("points", "are integers: points of a shape are in user units")
    return Shape({"hull": rows.tolist()})


def parts(shapes: Sequence[Shape]) -> Shape:
    """Several convex shapes that move together, such as a cutter and its holder: at most 64."""
    return Shape({"parts": [shape.to_dict() for shape in shapes]})


def cylinder(
    diameter: float, length: float, *, at: ArrayLike = (0, 0, 0), sides: int = 32, polygon: Polygon = "equal_area"
) -> Shape:
    """A stock: an upright round bar, ``at`` the middle of its lower end."""
    document = _cutter("flat", diameter, length, sides, polygon, at).to_dict()
    return Shape({"cylinder": document["flat"]})


def stock_document(stock: Shape | tuple[ArrayLike, ArrayLike]) -> dict[str, Any]:
    """A stock as the HTTP API takes it."""
    shape = stock if isinstance(stock, Shape) else box(*stock)
    document = shape.to_dict()
    corners: dict[str, Any] = document.get("box", document)
    return corners


def _cutter(
    form: str,
    diameter: float,
    length: float,
    sides: int,
    polygon: str,
    at: ArrayLike | None,
    **particulars: float | None,
) -> Shape:
    cutter: dict[str, Any] = {"diameter": float(diameter), "length": float(length), "sides": int(sides), "polygon": polygon}
    cutter |= {name: value for name, value in particulars.items() if value is not None}
    if at is not None:
        cutter["at"] = _vector("at", at)
    return Shape({form: cutter})


def _vector(name: str, value: ArrayLike) -> list[float]:
    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise invalid(name, "is not three finite numbers", value)
    return [float(coordinate) for coordinate in vector]
