"""Where scenes can be beside memory, and measuring without a scene."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from numpy.typing import ArrayLike

from . import _native as native
from ._documents import MassProperties
from ._errors import NotFound
from ._scene import Progress, Scene
from ._settings import Anchor, Kind, Rounding, Stock, settings_of
from ._shapes import Shape

__all__ = ["connect", "measure", "open"]


def open(
    path: str | os.PathLike[str],
    edge: float | None = None,
    *,
    kind: Kind = "cubes",
    shapes: Mapping[str, Shape] | None = None,
    steps_per_unit: int | None = None,
    unit: str = "mm",
    density: float = 1.0,
    anchor: Anchor | None = None,
    rounding: Rounding = "nearest",
    stock: Stock | None = None,
) -> Scene:
    """Opens a durable scene: ``"data/part"`` is the scene ``part`` of the data directory ``data``, as a server has it.

    A change is on stable storage when its call returns. The directory is locked as long as any of its scenes is open: a server,
    or another process, that uses it is told so. `Scene.close`, or a ``with`` block, lets go of it.

    Args:
        path: Data directory and name of the scene, ``[a-z0-9][a-z0-9._-]{0,62}``.
        edge: As of `Scene`, with the other settings: makes the scene where it is not there yet, as ``kind="solids"`` does. Without
            either the scene is opened with the settings that it has.

    Raises:
        NotFound: There is no such scene, and neither ``edge`` nor ``kind`` to make it with.
        Conflict: The scene has other settings.
        Unavailable: The directory cannot be used, or another process uses it.
    """
    whole = Path(path)
    wanted = None
    if edge is not None or kind != "cubes":
        wanted = settings_of(edge, kind, shapes, steps_per_unit, unit, density, anchor, rounding, stock)
    elif not (whole.parent / "scenes" / whole.name).is_dir():
        document = {"type": "/problems/no-such-scene", "status": 404, "detail": f"there is no scene {whole}: give the edge of its cubes, or kind"}
        raise NotFound(document)
    return Scene._of(native.Scene.directory(whole.parent, whole.name, wanted))


def connect(
    url: str,
    edge: float | None = None,
    *,
    key: str | None = None,
    ca: str | os.PathLike[str] | None = None,
    kind: Kind = "cubes",
    shapes: Mapping[str, Shape] | None = None,
    steps_per_unit: int | None = None,
    unit: str = "mm",
    density: float = 1.0,
    anchor: Anchor | None = None,
    rounding: Rounding = "nearest",
    stock: Stock | None = None,
) -> Scene:
    """Connects to a scene of a server: ``"http://127.0.0.1:7373/part"`` is its scene ``part``.

    A change is on the server's stable storage when its call returns. Each has an idempotency key of its own, so that it is sent again
    when an answer was lost; a server that has answered once is waited for while it is away, for up to 30 seconds.

    Args:
        url: Address of the server (``http://`` or ``https://``) and name of the scene, ``[a-z0-9][a-z0-9._-]{0,62}``.
        edge: As of `Scene`, with the other settings: makes the scene where it is not there yet, as ``kind="solids"`` does. Without
            either the scene is opened with the settings that it has.
        key: Sent as ``Authorization: Bearer KEY``, for a server or a proxy before it that asks for one.
        ca: File of certificates (PEM) that are trusted besides the machine's authorities, for a server with ``https://``.

    Raises:
        InvalidInput: The address is none.
        NotFound: There is no such scene, and neither ``edge`` nor ``kind`` to make it with.
        Conflict: The scene has other settings.
        Forbidden: The key is not one for that.
        Unavailable: Nobody answers there.
    """
    wanted = None
    if edge is not None or kind != "cubes":
        wanted = settings_of(edge, kind, shapes, steps_per_unit, unit, density, anchor, rounding, stock)
    return Scene._of(native.Scene.server(url, wanted, key, None if ca is None else Path(ca)))


def measure(
    corners: ArrayLike,
    edge: float,
    *,
    steps_per_unit: int | None = None,
    unit: str = "mm",
    density: float = 1.0,
    anchor: Anchor | None = None,
    rounding: Rounding = "nearest",
    stock: Stock | None = None,
    progress: Progress | None = None,
) -> MassProperties:
    """The mass properties of the union of cubes, without keeping a scene.

    Args:
        corners: Where the cubes are, (count, 3), as `Scene.insert` takes it.
        edge: Edge of every cube, with the other settings as of `Scene`.
        progress: Called after each million of cubes with their number.

    Example:
        >>> import union3d
        >>> union3d.measure([[0, 0, 0], [1, 0, 0]], edge=1).area
        10.0
    """
    scene = Scene(
        edge,
        steps_per_unit=steps_per_unit,
        unit=unit,
        density=density,
        anchor=anchor,
        rounding=rounding,
        stock=stock,
        history=0,
    )
    scene.insert(None, corners, progress=progress)
    return scene.mass_properties
