"""Exact mass properties of the union of solids, kept current while solids are inserted and deleted.

    >>> import union3d
    >>> part = union3d.Scene(edge=6)
    >>> change = part.insert([1, 2, 3], [[0, 0, 0], [3, 0, 0], [20, 0, 0]])
    >>> part.mass_properties.volume
    540.0

`Scene` is a scene in memory; `open` opens one in a directory, durable; `connect` reaches one of a server.
"""

from ._async import AsyncScene
from ._documents import (
    Bounds,
    Change,
    Contained,
    EdgeLength,
    Exact,
    FixedPoint,
    History,
    MassProperties,
    Measures,
    Side,
    Vertices,
)
from ._errors import Conflict, Fault, Forbidden, InvalidInput, NotFound, Unavailable, Union3dError
from ._places import connect, measure, open
from ._scene import Batch, Scene, Solid
from ._shapes import Shape, ball, box, bull, cylinder, drill, flat, hull, parts, tapered, vee

__all__ = [
    "AsyncScene",
    "Batch",
    "Bounds",
    "Change",
    "Conflict",
    "Contained",
    "EdgeLength",
    "Exact",
    "Fault",
    "FixedPoint",
    "Forbidden",
    "History",
    "InvalidInput",
    "MassProperties",
    "Measures",
    "NotFound",
    "Scene",
    "Shape",
    "Side",
    "Solid",
    "Unavailable",
    "Union3dError",
    "Vertices",
    "ball",
    "box",
    "bull",
    "connect",
    "cylinder",
    "drill",
    "flat",
    "hull",
    "measure",
    "open",
    "parts",
    "tapered",
    "vee",
]
