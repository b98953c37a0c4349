"""Settings of scenes, as the HTTP API takes them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Literal

from numpy.typing import ArrayLike

from ._errors import invalid
from ._shapes import Shape, stock_document

Kind = Literal["cubes", "solids"]
Anchor = Literal["corner", "center"]
Rounding = Literal["nearest", "reject"]

Stock = Shape | tuple[ArrayLike, ArrayLike]
"""Least and greatest corner of a block of material, in user units; of a scene of solids also `box`, `hull` or `cylinder`."""


def settings_of(
    edge: float | None,
    kind: Kind,
    shapes: Mapping[str, Shape] | None,
    steps_per_unit: int | None,
    unit: str,
    density: float,
    anchor: Anchor | None,
    rounding: Rounding,
    stock: Stock | None,
) -> str:
    """Settings as the HTTP API takes them; what a kind of scene does not have is refused there."""
    wanted: dict[str, Any] = {"kind": kind, "unit": unit, "density": number_of("density", density), "rounding": rounding}
    if edge is not None:
        wanted["edge"] = number_of("edge", edge)
    if steps_per_unit is not None:
        wanted["steps_per_unit"] = number_of("steps_per_unit", steps_per_unit)
    if anchor is not None:
        wanted["anchor"] = anchor
    if shapes is not None:
        wanted["shapes"] = {name: shape.to_dict() for name, shape in shapes.items()}
    if stock is not None:
        wanted["stock"] = stock_document(stock)
    return json.dumps(wanted)


def number_of(name: str, value: Any) -> float:
    """A finite number, of Python's own type: JSON has no others."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise invalid(name, "is not a finite number", value)
    return number
