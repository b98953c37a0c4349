"""Random changes: every place says the same, to the last integer."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Server
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import union3d

COORDINATE = st.integers(-12, 12)
CUBES = st.dictionaries(st.integers(0, 15), st.tuples(COORDINATE, COORDINATE, COORDINATE), max_size=8)
CHANGES = st.lists(
    st.one_of(
        st.tuples(st.just("insert"), CUBES),
        st.tuples(st.just("move"), CUBES),
        st.tuples(st.just("delete"), st.lists(st.integers(0, 15), max_size=6)),
        st.tuples(st.just("revert"), st.integers(0, 6)),
    ),
    max_size=8,
)
NUMBERS = itertools.count()


def voxels(corners: NDArray[Any], edge: int) -> NDArray[np.bool_]:
    """The union of the cubes, unit by unit: the slow truth."""
    filled = np.zeros((40, 40, 40), dtype=np.bool_)
    for x, y, z in corners + 12:
        filled[x : x + edge, y : y + edge, z : z + edge] = True
    return filled


def apply(scene: union3d.Scene, kind: str, what: object) -> object:
    """What comes of a change, refusals included."""
    try:
        if kind == "delete":
            done = scene.delete(np.array(what, dtype=np.int64))
        elif kind == "revert":
            assert isinstance(what, int)
            done = scene.revert(what)
        else:
            assert isinstance(what, dict)
            ids, corners = np.array(list(what), dtype=np.int64), np.array(list(what.values()), dtype=np.int64)
            done = (scene.insert if kind == "insert" else scene.move)(ids, corners)
    except union3d.Union3dError as refused:
        return type(refused), refused.code, str(refused), refused.faults
    return done


@settings(max_examples=25, deadline=None, derandomize=True)
@given(changes=CHANGES, edge=st.integers(1, 9), with_stock=st.booleans())
def test_all_places_say_the_same(
    changes: list[tuple[str, object]],
    edge: int,
    with_stock: bool,
    tmp_path_factory: pytest.TempPathFactory,
    server: Server,
) -> None:
    data, name = Path(tmp_path_factory.getbasetemp()) / "properties", f"random-{next(NUMBERS)}"
    stock = ([-3, -3, -3], [9, 9, 9]) if with_stock else None
    common: dict[str, Any] = {"steps_per_unit": 1, "stock": stock}
    memory = union3d.Scene(edge, **common)
    with (
        union3d.open(data / name, edge, **common) as directory,
        union3d.connect(f"{server.url}/{name}", edge, **common) as remote,
    ):
        for kind, what in changes:
            done = [apply(scene, kind, what) for scene in (memory, directory, remote)]
            assert done[0] == done[1] == done[2]
            documents = [scene.mass_properties.to_dict() for scene in (memory, directory, remote)]
            for document in documents:
                document.pop("scene")
            assert documents[0] == documents[1] == documents[2]
        ids, corners = memory.cubes(steps=True)
        for other in (directory, remote):
            assert np.array_equal(ids, other.cubes()[0]) and np.array_equal(corners, other.cubes(steps=True)[1])
        histories = [scene.history() for scene in (memory, directory, remote)]
        for column in histories[0]:
            if column != "time":
                for history in histories[1:]:
                    np.testing.assert_array_equal(histories[0][column], history[column])
        points = np.random.default_rng(edge).integers(-13, 14, (10, 3))
        found = [np.stack(scene.contains(points)) for scene in (memory, directory, remote)]
        assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])
        assert memory.mass_properties.exact.volume == int(voxels(corners, edge).sum())
        assert memory.audit() == directory.audit() == remote.audit() == len(ids)
