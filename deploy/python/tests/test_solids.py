"""Scenes of solids, wherever they are."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from conftest import MakeScene
from hypothesis import given, settings
from hypothesis import strategies as st

import union3d

FLAT = union3d.flat(diameter=6, length=25, sides=8)
STOCK = union3d.box([0, 0, -10], [80, 60, 0])


def milled(make_scene: MakeScene, **settings: Any) -> union3d.Scene:
    return make_scene(None, kind="solids", **{"shapes": {"t1": FLAT}, "stock": STOCK, **settings})


def test_a_slot(make_scene: MakeScene) -> None:
    part = milled(make_scene)
    assert part.kind == "solids" and part.settings["shapes"]["t1"]["flat"]["sides"] == 8
    change = part.insert_sweeps([1], "t1", [[10, 10, -2]], [[50, 10, -2]])
    assert (change.seq, change.inserted) == (1, 1)
    properties = part.mass_properties
    assert properties.bodies == len(part) == part.audit() == 1
    removed, remaining = properties.removed, properties.remaining
    assert removed is not None and remaining is not None
    # The octagon of a circle's area has the width of its inner circle's diameter: the slot is that wide, and 2 deep.
    octagon = np.pi * 9
    across = 2 * np.sqrt(octagon / (8 * np.tan(np.pi / 8)))
    assert removed.volume == pytest.approx(2 * (40 * across + octagon), rel=1e-3)
    assert removed.volume + remaining.volume == 48_000
    exact = properties.exact.volume
    assert isinstance(exact, union3d.FixedPoint) and exact == change.exact_volume_removed
    assert float(exact.fraction) / 10_000**3 == properties.volume
    assert exact.error_max / exact.divisor / 10_000**3 == pytest.approx(properties.error_max["volume"])
    assert pickle.loads(pickle.dumps(exact)).divisor == exact.divisor
    assert len(properties.exact.first_moments) == 3 and len(properties.exact.second_moments) == 6
    assert properties.exact.edge_length.total == properties.exact.edge_length.convex
    for name in ("euler_characteristic", "vertices", "mean_curvature"):
        with pytest.raises(AttributeError, match="not measured of solids"):
            getattr(properties, name)
    with pytest.raises(AttributeError, match="area_by_axis"):
        _ = properties.exact.area_by_axis
    assert "solids" in repr(part) and "removed" in repr(properties)


def test_hulls_and_shapes_that_stay(make_scene: MakeScene) -> None:
    part = milled(make_scene, stock=None)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    part.insert_hulls([5, 6], [cube * 1.0, cube * 10_000])
    part.define("brick", union3d.box([0, 0, 0], [2, 2, 2]))
    part.insert_sweeps([7], "brick", [[5, 0, 0]])
    assert part.mass_properties.volume == 9.0
    solids = part.solids()
    assert [(solid.id, solid.shape, solid.start, solid.end) for solid in solids] == [
        (5, None, None, None),
        (6, None, None, None),
        (7, "brick", (5, 0, 0), (5, 0, 0)),
    ]
    assert solids[0].hull is not None and sorted(solids[0].hull.tolist()) == sorted((cube * 1.0).tolist())
    found = part.contains(np.array([[0.5, 0.5, 0.5], [6, 1, 1], [7, 1, 1], [9, 9, 9]]))
    assert found.side.tolist() == [2, 2, 1, 0] and found.id.tolist() == [5, 7, 7, 0]
    assert part.delete([5]).volume_removed == 0.0
    assert part.delete([6, 7, 8]).unchanged == 1
    assert part.insert_hulls(None, [cube * 1.0]).ids.tolist() == [8]


def test_several_shapes_and_chunks(make_scene: MakeScene) -> None:
    part, done = milled(make_scene), list[int]()
    part.define("t2", union3d.ball(diameter=4, length=20, sides=6, rings=2))
    start = np.array([[10.0, 10, -2], [20, 20, -2], [30, 30, -2]])
    change = part.insert_sweeps([1, 2, 3], ["t1", "t2", "t1"], start, start + [5, 0, 0], chunk=2, progress=done.append)
    assert (change.inserted, change.seq, done) == (3, 2, [2, 1])
    assert [solid.shape for solid in part.solids()] == ["t1", "t2", "t1"]
    assert part.insert_sweeps(None, "t1", [40, 40, -1]).ids.tolist() == [4]


def test_a_line_is_one_change_and_is_foreseen(make_scene: MakeScene) -> None:
    part = milled(make_scene)
    sweep = ([1], "t1", [[10, 10, -2]], [[50, 10, -2]])
    foreseen = part.dry_run(sweeps=sweep)
    assert foreseen.dry_run and part.seq == 0
    done = part.change(sweeps=sweep, move=17, duration=0.5)
    assert done.exact_volume_removed == foreseen.exact_volume_removed
    assert part.mass_properties.exact == foreseen.mass_properties.exact
    with part.batch(move=18) as batch:
        batch.insert_sweeps([2, 3], "t1", [[10, 20, -2]] * 2, [[50, 20, -2], [50, 30, -2]])
        batch.insert_hulls([4], [[[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, -9]]])
        batch.delete([2])
    assert (batch.change.inserted, part.seq, [solid.id for solid in part.solids()]) == (2, 2, [1, 3, 4])
    history = part.history()
    assert history.move.tolist() == [17, 18] and history.solids.tolist() == [1, 3]
    assert history.removal_rate[0] == pytest.approx(done.volume_removed / 0.5)
    part.revert(1)
    assert part.mass_properties.exact == foreseen.mass_properties.exact


def test_faults_have_places(make_scene: MakeScene) -> None:
    part = milled(make_scene)
    flat = [[10, 10, -2]]
    cases: list[tuple[Any, str]] = [
        (lambda: part.insert_sweeps([1], "t9", flat), "shapes[0]"),
        (lambda: part.insert_sweeps([1], "t1", [[10, 10, np.nan]]), "start[0, 2]"),
        (lambda: part.insert_sweeps([1], "t1", flat, [[0, 1e9, 0]]), "end[0, 1]"),
        (lambda: part.insert_sweeps([1], "t1", np.array([[2**31, 0, 0]])), "start[0, 0]"),
        (lambda: part.insert_sweeps([1], "t1", flat, [[3000, 10, -2]]), "end[0, 0]"),
        (lambda: part.insert_sweeps([1, 2], "t1", flat), "ids"),
        (lambda: part.insert_sweeps([1], ["t1", "t1"], flat), "shape"),
        (lambda: part.insert_hulls([1], [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]), "hulls[0]"),
        (lambda: part.define("t 2", FLAT), "the request"),
        (lambda: part.define("t2", union3d.flat(diameter=0, length=1)), "flat.diameter"),
        (lambda: milled(make_scene, stock=union3d.cylinder(diameter=-1, length=5)), "stock.cylinder.diameter"),
    ]
    for call, place in cases:
        with pytest.raises(union3d.InvalidInput) as refused:
            call()
        assert refused.value.faults[0].place == place, str(refused.value)
    part.insert_sweeps([1], "t1", flat)
    with pytest.raises(union3d.Conflict, match="another body"):
        part.insert_sweeps([1], "t1", [[20, 20, -2]])
    with pytest.raises(union3d.Conflict) as exists:
        part.define("t1", union3d.flat(diameter=8, length=25))
    assert exists.value.code == "shape-exists"
    assert len(part) == 1


def test_each_kind_has_its_own_calls(make_scene: MakeScene) -> None:
    solids, cubes = milled(make_scene), make_scene(6)
    for call in (
        lambda: solids.insert([1], [[0, 0, 0]]),
        lambda: solids.cubes(),
        lambda: solids.move([1], [[0, 0, 0]]),
        lambda: solids.change(insert=([1], [[0, 0, 0]])),
        lambda: cubes.insert_sweeps([1], "t1", [[0, 0, 0]]),
        lambda: cubes.insert_hulls([1], [[[0, 0, 0]]]),
        lambda: cubes.define("t1", FLAT),
        lambda: cubes.solids(),
        lambda: cubes.dry_run(sweeps=([1], "t1", [[0, 0, 0]], None)),
    ):
        with pytest.raises(union3d.Conflict) as refused:
            call()
        assert refused.value.code == "other-kind"
    with pytest.raises(AttributeError, match="no edge"):
        _ = solids.edge
    with pytest.raises(union3d.InvalidInput, match="edge"):
        union3d.Scene()


STOCKS = [
    ([0, 0, -10], [80, 60, 0]),
    union3d.hull([[0, 0, -10], [80, 0, -10], [0, 60, -10], [0, 0, 0]]),
    union3d.cylinder(diameter=50, length=20, sides=12, at=[0, 0, -20]),
]


@pytest.mark.parametrize("stock", STOCKS)
def test_stocks(make_scene: MakeScene, stock: Any) -> None:
    part = milled(make_scene, stock=stock)
    remaining = part.mass_properties.remaining
    assert remaining is not None and remaining.volume > 0
    assert part.insert_sweeps([1], "t1", [[5, 5, -8]]).volume_removed > 0


ALL_SHAPES = {
    "flat": FLAT,
    "ball": union3d.ball(6, 20),
    "bull": union3d.bull(6, 20, corner_radius=1),
    "vee": union3d.vee(6, 20, angle=90),
    "drill": union3d.drill(6, 20),
    "tapered": union3d.tapered(6, 20, angle=10, tip=1),
    "box": union3d.box([-1, -1, 0], [1, 1, 5]),
    "hull": union3d.hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "parts": union3d.parts([FLAT, union3d.flat(20, 30, at=[0, 0, 25])]),
    "high": FLAT.with_top(40),
}


def test_every_shape(make_scene: MakeScene) -> None:
    part = milled(make_scene, shapes=ALL_SHAPES, stock=None)
    start = np.array([[100.0 * index, 0, 0] for index in range(len(ALL_SHAPES))])
    part.insert_sweeps(range(len(ALL_SHAPES)), list(ALL_SHAPES), start)
    assert len(part) == len(ALL_SHAPES) == part.audit()
    assert [solid.shape for solid in part.solids()] == list(ALL_SHAPES)
    assert part.mass_properties.volume == pytest.approx(
        sum(part.dry_run(delete=[index]).volume_removed * -1 for index in range(len(ALL_SHAPES)))
    )


POINT = st.tuples(*[st.integers(0, 8)] * 3)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(boxes=st.lists(st.tuples(POINT, POINT), max_size=6))
def test_boxes_are_what_cubes_are(boxes: list[tuple[tuple[int, ...], tuple[int, ...]]]) -> None:
    """The union of boxes as solids has the volume and the area of the unit cubes that fill it."""
    solids = union3d.Scene(kind="solids", steps_per_unit=1)
    cubes = union3d.Scene(1, steps_per_unit=1)
    for index, (one, other) in enumerate(boxes):
        low, high = np.minimum(one, other), np.maximum(one, other) + 1
        corners = np.stack(np.meshgrid(*(np.arange(*ends) for ends in zip(low, high, strict=True))), -1).reshape(-1, 3)
        cubes.insert(None, corners)
        solids.insert_hulls([index], [np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)])
    assert solids.mass_properties.exact.volume == cubes.mass_properties.exact.volume * 96
    assert solids.mass_properties.area == cubes.mass_properties.area
