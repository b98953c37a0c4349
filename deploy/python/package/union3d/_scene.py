"""Scenes: sets of cubes or solids whose mass properties are current, in memory, in a directory or on a server."""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native as native
from ._arrays import ids_of, positions_of, same_count, whole_of
from ._documents import Change, Contained, History, MassProperties
from ._errors import Conflict, invalid
from ._insertion import Cubes, Hulls, Insertion, Sweeps, joined
from ._settings import Anchor, Kind, Rounding, Stock, settings_of
from ._shapes import Shape

__all__ = ["Batch", "Scene", "Solid"]

Progress = Callable[[int], object]
"""Called with the number of bodies done since the last call: ``tqdm(total=..).update`` is one."""

CHUNK = 1_000_000
"""Cubes that `insert`, `delete` and `move` send in one atomic change."""

CHUNK_SOLIDS = 1_000
"""Solids that `insert_sweeps` and `insert_hulls` send in one atomic change."""


class Solid(NamedTuple):
    """A solid of a scene: a shape that is carried along a segment, or a hull. Units: user units."""

    id: int
    shape: str | None
    """The name of its shape; ``None`` of a hull."""
    start: tuple[float, float, float] | None
    """Where the shape's anchor is carried from."""
    end: tuple[float, float, float] | None
    """Where it is carried to: the same point when it stays."""
    hull: NDArray[np.float64] | None
    """Vertices of a hull, (count, 3)."""


class Scene:
    """A set of equal cubes, or of convex solids, whose mass properties are current and exact after every change.

    ``Scene(edge=6)`` is in memory: the engine called directly, gone with the object. `union3d.open` gives the same object for a
    durable scene in a directory, `union3d.connect` for one of a server.

    Positions are NumPy arrays or sequences of shape (count, 3): **floats, and plain lists, are user units** of what the scene's
    anchor says (a cube's lower corner or its centre); **integer arrays are lattice steps** of the lower corner. Ids are whole
    numbers from 0 to 2⁶⁴ − 1 that you choose; without any the scene numbers its bodies.

    With ``kind="solids"`` it holds convex solids instead: shapes that are carried along segments, as a cutter is, and hulls; see
    `insert_sweeps` and `insert_hulls`.

    A change is applied whole or refused whole, with an exception that names each place and value at fault. Inserting a cube
    that is there already, or deleting one that is not, changes nothing and counts as ``unchanged``.

    Methods release the interpreter's lock, and may be called from several threads.

    Example:
        >>> import union3d
        >>> part = union3d.Scene(edge=6)
        >>> part.insert([1, 2, 3], [[0, 0, 0], [3, 0, 0], [20, 0, 0]]).inserted
        3
        >>> part.mass_properties.volume
        540.0
        >>> part.mass_properties.exact.volume
        540000000000
    """

    _native: native.Scene
    _settings: dict[str, Any]

    def __init__(
        self,
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
        history: int = 10_000,
    ) -> None:
        """Makes a scene in memory.

        Args:
            edge: Edge of every cube, a whole number of lattice steps from 1 to 2²⁴. Units: user units. Of cubes only, which need it.
            kind: What it holds: ``"cubes"`` or ``"solids"``.
            shapes: Shapes by name, of solids only; `define` adds others.
            steps_per_unit: Lattice steps in a user unit, 1 to 10⁹; 1,000 of cubes and 10,000 of solids unless said.
            unit: Label of the user unit.
            density: Mass of a cubic user unit, above 0.
            anchor: What a position in user units names: ``"corner"``, the lower one (unless said), or ``"center"``. Of cubes only.
            rounding: What becomes of a coordinate between two steps: ``"nearest"``, or ``"reject"``.
            stock: A block that the bodies are cut from: then the mass properties say what is removed and what remains.
            history: Newest changes that are kept in memory, for `history`, `revert` and `mass_properties_at`. A kept change takes about
                a kilobyte, and 24 bytes for each cube that it inserts or deletes.

        Raises:
            InvalidInput: A setting is out of its range.
        """
        if history < 0:
            raise invalid("history", "is below 0", history)
        if edge is None and kind == "cubes":
            raise invalid("edge", "is missing: a scene of cubes needs the edge of its cubes")
        wanted = settings_of(edge, kind, shapes, steps_per_unit, unit, density, anchor, rounding, stock)
        self._take(native.Scene.memory(wanted, history))

    def _take(self, made: native.Scene) -> None:
        self._native = made
        self._settings = json.loads(made.described)

    @classmethod
    def _of(cls, made: native.Scene) -> Scene:
        scene = cls.__new__(cls)
        scene._take(made)
        return scene

    # What it is

    @property
    def name(self) -> str | None:
        """Its name in its directory or on its server; ``None`` in memory."""
        return self._settings.get("name")

    @property
    def kind(self) -> Kind:
        """What it holds."""
        return "solids" if self._settings.get("kind") == "solids" else "cubes"

    @property
    def edge(self) -> float:
        """Edge of every cube. Units: user units."""
        if self.kind == "solids":
            raise AttributeError("a scene of solids has no edge")
        return float(self._settings["edge"])

    @property
    def steps_per_unit(self) -> int:
        """Lattice steps in a user unit."""
        return int(self._settings["steps_per_unit"])

    @property
    def unit(self) -> str:
        """Label of the user unit."""
        return str(self._settings["unit"])

    @property
    def settings(self) -> dict[str, Any]:
        """What it was made with, as the HTTP API has it."""
        names = ("kind", "edge", "steps_per_unit", "unit", "density", "anchor", "rounding", "stock", "shapes")
        return {name: self._settings[name] for name in names if name in self._settings}

    def __len__(self) -> int:
        """Number of cubes or solids; two at one place count twice."""
        return self.mass_properties.bodies

    def __bool__(self) -> bool:
        return True

    def __repr__(self) -> str:
        where = "in memory" if self.name is None else repr(self.name)
        what = "solids" if self.kind == "solids" else f"cubes of {self.edge:.9g} {self.unit}"
        return f"<Scene {where}: {what}, {self.steps_per_unit} steps to the {self.unit}>"

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(repr(self).strip('<>'))}</p>" + self.mass_properties._repr_html_()

    # Changes

    def insert(
        self,
        ids: ArrayLike | range | None,
        corners: ArrayLike,
        *,
        chunk: int = CHUNK,
        progress: Progress | None = None,
    ) -> Change:
        """Inserts cubes.

        Up to ``chunk`` of them are one atomic change; more are several changes one after the other, between which
        ``KeyboardInterrupt`` is raised: what is in by then stays, and inserting the same again is safe.

        Args:
            ids: Their ids, (count,), or ``None``: then the scene numbers them (`Change.ids`).
            corners: Where they are, (count, 3).
            chunk: Most cubes of one change, 1 to 2²⁴.
            progress: Called after each change with the number of cubes in it.

        Raises:
            InvalidInput: A position or an id is wrong, or an id stands at two places.
            Conflict: An id is at another place already.
        """
        self._only("cubes", "insert_sweeps or insert_hulls")
        named = None if ids is None else ids_of(ids)
        places = positions_of(corners)
        same_count(named, places)

        def send(part: slice) -> str:
            return self._native.change_cubes(None, None if named is None else named[part], places[part], None, None, False)

        return self._in_chunks(len(places), chunk, progress, send)

    def define(self, name: str, shape: Shape) -> None:
        """Defines a shape of a scene of solids; one that is there already stays as it is.

        Args:
            name: 1 to 63 letters, digits, ``.``, ``_`` and ``-``, the first a letter or digit.
            shape: As `flat` and its neighbours make it.

        Raises:
            Conflict: There is another shape of this name.
        """
        self._only("solids", "insert")
        self._native.define(name, json.dumps(shape.to_dict()))

    def insert_sweeps(
        self,
        ids: ArrayLike | range | None,
        shape: str | Sequence[str],
        start: ArrayLike,
        end: ArrayLike | None = None,
        *,
        chunk: int = CHUNK_SOLIDS,
        progress: Progress | None = None,
    ) -> Change:
        """Inserts shapes that are carried along segments, into a scene of solids; in chunks as `insert` does.

        Args:
            ids: Their ids, (count,), or ``None``: then the scene numbers them.
            shape: The name of their shape, or a name for each.
            start: Where their anchors are carried from, (count, 3).
            end: Where they are carried to, (count, 3); ``None``: they stay.
            chunk: Most solids of one change.
            progress: Called after each change with the number of solids in it.
        """
        self._only("solids", "insert")
        whole = Insertion()
        whole.add_sweeps(ids, shape, start, end)

        def send(part: slice) -> str:
            some = Insertion(
                [named[part] for named in whole.ids],
                whole.shapes[part],
                [rows[part] for rows in whole.start],
                [rows[part] for rows in whole.end],
            )
            return self._send(None, some)

        return self._in_chunks(len(whole.shapes), chunk, progress, send)

    def insert_hulls(
        self,
        ids: ArrayLike | range | None,
        hulls: Sequence[ArrayLike],
        *,
        chunk: int = CHUNK_SOLIDS,
        progress: Progress | None = None,
    ) -> Change:
        """Inserts convex hulls of points into a scene of solids; in chunks as `insert` does.

        Args:
            ids: Their ids, (count,), or ``None``: then the scene numbers them.
            hulls: The points of each, (points, 3).
            chunk: Most solids of one change.
            progress: Called after each change with the number of solids in it.
        """
        self._only("solids", "insert")
        whole = Insertion()
        whole.add_hulls(ids, hulls)

        def send(part: slice) -> str:
            return self._send(None, Insertion(hull_ids=[named[part] for named in whole.hull_ids], hulls=whole.hulls[part]))

        return self._in_chunks(len(whole.hulls), chunk, progress, send)

    def delete(self, ids: ArrayLike | range, *, chunk: int = CHUNK, progress: Progress | None = None) -> Change:
        """Deletes cubes or solids; in chunks as `insert` does.

        Args:
            ids: Their ids, (count,). One that is not there counts as ``unchanged``.
            chunk: Most bodies of one change, 1 to 2²⁴.
            progress: Called after each change with the number of bodies in it.
        """
        named = ids_of(ids)
        return self._in_chunks(len(named), chunk, progress, lambda part: self._send(named[part], Insertion()))

    def move(
        self,
        ids: ArrayLike | range,
        corners: ArrayLike,
        *,
        chunk: int = CHUNK // 2,
        progress: Progress | None = None,
    ) -> Change:
        """Puts cubes to other places, in chunks as `insert` does. A cube that is not there yet is inserted.

        Args:
            ids: Their ids, (count,).
            corners: Where they are then, (count, 3).
            chunk: Most cubes of one change, 1 to 2²³.
            progress: Called after each change with the number of cubes in it.
        """
        self._only("cubes", "change")
        named, places = ids_of(ids), positions_of(corners)
        same_count(named, places)

        def send(part: slice) -> str:
            return self._send(named[part], Insertion([named[part]], start=[places[part]]))

        return self._in_chunks(len(places), chunk, progress, send)

    def change(
        self,
        *,
        delete: ArrayLike | range | None = None,
        insert: Cubes | None = None,
        sweeps: Sweeps | None = None,
        hulls: Hulls | None = None,
        move: int | None = None,
        duration: float | None = None,
    ) -> Change:
        """Deletes, then inserts bodies, as one atomic change of at most 2²⁴ of them.

        Args:
            delete: Ids to delete, (count,).
            insert: ``(ids, corners)`` of cubes, as `insert` takes them.
            sweeps: ``(ids, shape, start, end)`` of solids, as `insert_sweeps` takes them.
            hulls: ``(ids, hulls)`` of solids, as `insert_hulls` takes them.
            move: Your number of the move or program line that it belongs to; it stands in the history. A change with a move
                or a duration counts even when it has no bodies.
            duration: Machine time of the change. Units: seconds.
        """
        return self._change(delete, self._insertion(insert, sweeps, hulls), (move, duration), dry_run=False)

    def dry_run(
        self,
        *,
        delete: ArrayLike | range | None = None,
        insert: Cubes | None = None,
        sweeps: Sweeps | None = None,
        hulls: Hulls | None = None,
    ) -> Change:
        """Says what `change` would do, with the mass properties after it, and does nothing."""
        return self._change(delete, self._insertion(insert, sweeps, hulls), (None, None), dry_run=True)

    def batch(self, *, move: int | None = None, duration: float | None = None) -> Batch:
        """Gathers calls into one atomic change, which is made at the end of the ``with`` block, or not at all when it raises.

        Example:
            >>> import union3d
            >>> part = union3d.Scene(edge=1)
            >>> with part.batch(move=17, duration=0.4) as batch:
            ...     batch.insert([1, 2], [[0, 0, 0], [1, 0, 0]])
            ...     batch.delete([1])
            >>> batch.change.inserted
            1
        """
        return Batch(self, move, duration)

    def revert(self, seq: int) -> Change:
        """Makes the set of cubes what it was after change ``seq``, as one new change; forward again likewise.

        Raises:
            NotFound: The scene has not come to that seq, or its changes since are not kept any more.
        """
        return Change._of([json.loads(self._native.revert(whole_of("seq", seq)))], self.unit)

    # Questions

    @property
    def mass_properties(self) -> MassProperties:
        """The mass properties now: floats in user units, and ``.exact`` integers in lattice steps."""
        return self.mass_properties_at()

    def mass_properties_at(self, seq: int | None = None) -> MassProperties:
        """The mass properties after change ``seq``; 0 is the empty scene, ``None`` the newest.

        Raises:
            NotFound: The scene has not come to that seq, or its totals are not kept any more.
        """
        at = None if seq is None else whole_of("seq", seq)
        return MassProperties(json.loads(self._native.mass_properties(at)), self.unit)

    @property
    def seq(self) -> int:
        """Number of the newest change; 0 before the first."""
        return self.mass_properties.seq or 0

    def history(
        self,
        start: int | None = None,
        stop: int | None = None,
        *,
        move_from: int | None = None,
        move_to: int | None = None,
        limit: int | None = None,
    ) -> History:
        """The totals after every change and what it did, oldest first, as columns.

        Args:
            start: First seq.
            stop: Last seq, included.
            move_from: Least number of a move; changes without one are left out then.
            move_to: Greatest number of a move; changes without one are left out then.
            limit: Most changes, at least 1.
        """
        given = {"start": start, "stop": stop, "move_from": move_from, "move_to": move_to, "limit": limit}
        start, stop, move_from, move_to, limit = (
            None if value is None else whole_of(name, value) for name, value in given.items()
        )
        if limit == 0:
            raise invalid("limit", "is 0: at least 1 is wanted")
        return History._of(self._native.history((start, stop), (move_from, move_to), limit))

    def contains(self, points: ArrayLike) -> Contained:
        """Where points lie in the union: (count, 3), rounded to the lattice as the scene's settings say.

        Example:
            >>> import union3d
            >>> part = union3d.Scene(edge=2)
            >>> _ = part.insert([7], [[0, 0, 0]])
            >>> part.contains([[1, 1, 1], [2, 1, 1], [3, 1, 1]]).side.tolist()
            [2, 1, 0]
        """
        return Contained(*self._native.contains(positions_of(points, "points")))

    def cubes(self, *, steps: bool = False) -> tuple[NDArray[np.uint64], NDArray[Any]]:
        """All cubes by their ids: ids (count,), and where they are (count, 3), as `insert` takes both.

        Args:
            steps: Lower corners in lattice steps (int32) instead of positions in user units (float64).
        """
        ids, corners = self._native.cubes()
        if steps:
            return ids, corners
        doubled = 2 * corners.astype(np.int64)
        if self._settings["anchor"] == "center":
            doubled += round(self.edge * self.steps_per_unit)
        return ids, doubled / self.steps_per_unit / 2

    def solids(self) -> list[Solid]:
        """All solids by their ids."""
        self._only("solids", "cubes")
        lines = (json.loads(line)["insert"] for line in self._native.solids().splitlines())
        return sorted((_solid(line) for line in lines), key=lambda solid: solid.id)

    def audit(self) -> int:
        """Recounts everything from the bodies alone, compares with the totals, and gives their number. O(bodies)

        Raises:
            Unavailable: They differ, which must never be: ``document`` has both.
        """
        return int(json.loads(self._native.audit())[self.kind])

    # Its life

    def close(self) -> None:
        """Lets go of the scene. A directory is free for other processes when the last of its scenes is closed."""
        self._native.close()

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _only(self, kind: Kind, instead: str) -> None:
        """Refuses what a scene of another kind has."""
        if self.kind != kind:
            detail = f"this is a scene of {self.kind}, and that call is for {kind}: see {instead}"
            raise Conflict({"type": "/problems/other-kind", "status": 409, "detail": detail})

    def _insertion(self, cubes: Cubes | None, sweeps: Sweeps | None, hulls: Hulls | None) -> Insertion:
        insertion = Insertion()
        if cubes is not None:
            self._only("cubes", "sweeps and hulls")
            insertion.add_cubes(*cubes)
        if sweeps is not None or hulls is not None:
            self._only("solids", "insert")
        if sweeps is not None:
            insertion.add_sweeps(*sweeps)
        if hulls is not None:
            insertion.add_hulls(*hulls)
        return insertion

    def _change(
        self,
        delete: ArrayLike | range | None,
        insertion: Insertion,
        motion: tuple[int | None, float | None],
        *,
        dry_run: bool,
    ) -> Change:
        gone = None if delete is None else ids_of(delete, "delete")
        move, duration = motion
        number = None if move is None else whole_of("move", move)
        seconds = None if duration is None else float(duration)
        answer = self._send(gone, insertion, (number, seconds), dry_run=dry_run)
        return Change._of([json.loads(answer)], self.unit)

    def _send(
        self,
        delete: NDArray[np.uint64] | None,
        insertion: Insertion,
        motion: tuple[int | None, float | None] = (None, None),
        *,
        dry_run: bool = False,
    ) -> str:
        ids = insertion.all_ids()
        start = joined(insertion.start, "start" if insertion.shapes else "corners")
        if self.kind == "cubes":
            return self._native.change_cubes(delete, ids, start, *motion, dry_run)
        shapes, shape = np.unique(np.array(insertion.shapes, dtype=np.str_), return_inverse=True)
        return self._native.change_solids(
            delete,
            ids,
            [str(name) for name in shapes],
            shape.astype(np.uint32),
            start,
            joined(insertion.end, "end"),
            insertion.hulls,
            *motion,
            dry_run,
        )

    def _in_chunks(
        self, count: int, chunk: int, progress: Progress | None, send: Callable[[slice], str]
    ) -> Change:
        if chunk < 1:
            raise invalid("chunk", "is below 1", chunk)
        answers: list[dict[str, Any]] = []
        for start in range(0, max(count, 1), chunk):
            part = slice(start, min(start + chunk, count))
            answers.append(json.loads(send(part)))
            if progress is not None:
                progress(part.stop - part.start)
        return Change._of(answers, self.unit)


class Batch:
    """Calls that become one atomic change: see `Scene.batch`. Every body has an id."""

    def __init__(self, scene: Scene, move: int | None, duration: float | None) -> None:
        self._scene = scene
        self._motion = (move, duration)
        self._delete: list[NDArray[np.uint64]] = []
        self._insertion = Insertion()
        self._done: Change | None = None

    def insert(self, ids: ArrayLike | range, corners: ArrayLike) -> None:
        """Inserts cubes when the batch ends: see `Scene.insert`."""
        self._scene._only("cubes", "insert_sweeps or insert_hulls")
        self._insertion.add_cubes(ids, corners)

    def insert_sweeps(
        self, ids: ArrayLike | range, shape: str | Sequence[str], start: ArrayLike, end: ArrayLike | None = None
    ) -> None:
        """Inserts shapes that are carried along segments when the batch ends: see `Scene.insert_sweeps`."""
        self._scene._only("solids", "insert")
        self._insertion.add_sweeps(ids, shape, start, end)

    def insert_hulls(self, ids: ArrayLike | range, hulls: Sequence[ArrayLike]) -> None:
        """Inserts convex hulls when the batch ends: see `Scene.insert_hulls`."""
        self._scene._only("solids", "insert")
        self._insertion.add_hulls(ids, hulls)

    def delete(self, ids: ArrayLike | range) -> None:
        """Deletes bodies when the batch ends; those that were inserted before in the batch are not inserted."""
        gone = ids_of(ids)
        self._insertion.leave_out(gone)
        self._delete.append(gone)

    def move(self, ids: ArrayLike | range, corners: ArrayLike) -> None:
        """Puts cubes to other places when the batch ends: see `Scene.move`."""
        named = ids_of(ids)
        self.delete(named)
        self.insert(named, corners)

    @property
    def change(self) -> Change:
        """What the change did, after the end of the batch."""
        if self._done is None:
            raise RuntimeError("the batch has not ended")
        return self._done

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            delete = np.concatenate(self._delete) if self._delete else None
            self._done = self._scene._change(delete, self._insertion, self._motion, dry_run=False)


def _solid(line: dict[str, Any]) -> Solid:
    start = line.get("from", line.get("at"))
    end = line.get("to", line.get("at"))
    hull = line.get("hull")
    return Solid(
        line["id"],
        line.get("shape"),
        None if start is None else tuple(start),
        None if end is None else tuple(end),
        None if hull is None else np.array(hull, dtype=np.float64),
    )
