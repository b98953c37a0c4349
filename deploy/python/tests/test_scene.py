"""What every scene promises, wherever it is."""

from __future__ import annotations

import pickle
import threading
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from conftest import MakeScene
from numpy.typing import ArrayLike

import union3d

THREE = [[0, 0, 0], [3, 0, 0], [20, 0, 0]]


def test_a_first_answer(make_scene: MakeScene) -> None:
    part = make_scene(6)
    change = part.insert([1, 2, 3], THREE)
    assert (change.seq, change.inserted, change.deleted, change.unchanged) == (1, 3, 0, 0)
    assert (change.volume_removed, change.exact_volume_removed) == (540.0, 540 * 10**9)
    properties = part.mass_properties
    assert (properties.seq, properties.bodies, len(part)) == (1, 3, 3)
    assert (properties.volume, properties.area, properties.mass) == (540.0, 504.0, 540.0)
    assert properties.edge_length == (156.0, 156.0, 0.0, 0.0)
    assert properties.exact.volume == 540 * 10**9 and isinstance(properties.exact.volume, int)
    assert properties.exact.area == 504 * 10**6 and properties.exact.steps_per_unit == 1000
    assert properties.exact.edge_length.convex == 156_000
    assert sum(properties.exact.area_by_axis) == properties.exact.area
    assert Fraction(properties.exact.first_moments2[0], 2 * properties.exact.volume) == 11_900
    assert properties.centroid is not None
    np.testing.assert_allclose(properties.centroid, [11.9, 3, 3], rtol=1e-15)
    assert properties.inertia.shape == (3, 3) and np.array_equal(properties.inertia, properties.inertia.T)
    assert properties.bounds == ((0, 0, 0), (26, 6, 6))
    assert (properties.euler_characteristic, properties.vertices.total, properties.vertices.corner) == (2, 16, 16)
    assert properties.mean_curvature == pytest.approx(np.pi / 4 * 156)
    assert properties.removed is None and properties.remaining is None
    with pytest.raises(AttributeError, match="exact"):
        _ = properties.error_max


def test_the_empty_scene(make_scene: MakeScene) -> None:
    part = make_scene()
    assert (part.seq, len(part), bool(part)) == (0, 0, True)
    assert part.mass_properties.centroid is None and part.mass_properties.bounds is None
    assert part.history()["seq"].size == 0
    ids, corners = part.cubes()
    assert ids.shape == (0,) and corners.shape == (0, 3)
    assert part.insert([], []).inserted == 0 and part.seq == 0
    assert part.audit() == 0


def test_a_retry_changes_nothing(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    again = part.insert([1, 2, 3], THREE)
    assert (again.seq, again.inserted, again.unchanged) == (1, 0, 3)
    assert part.delete([2, 9]).unchanged == 1 and part.delete([2, 9]).unchanged == 2
    assert part.seq == 2


def test_delete_and_move(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    moved = part.move([3], [[0, 0, 0]])
    assert (moved.inserted, moved.deleted) == (1, 1)
    assert part.mass_properties.volume == 324.0
    assert part.delete(range(1, 4)).deleted == 3
    assert part.mass_properties.volume == 0.0


def test_floats_and_lists_are_units_and_integer_arrays_are_steps(make_scene: MakeScene) -> None:
    part = make_scene(2, steps_per_unit=10)
    part.insert([1], [[1, 2, 3]])
    part.insert([2], np.array([[1.0, 2.0, 3.0]]))
    part.insert([3], np.array([[10, 20, 30]]))
    part.insert([4], np.array([[10, 20, 30]], dtype=np.uint16))
    part.insert([5], np.array([[1, 2, 3]], dtype=np.float32))
    assert part.mass_properties.volume == 8.0
    ids, corners = part.cubes()
    assert ids.dtype == np.uint64 and ids.tolist() == [1, 2, 3, 4, 5]
    assert corners.dtype == np.float64 and corners.tolist() == [[1, 2, 3]] * 5
    ids, steps = part.cubes(steps=True)
    assert steps.dtype == np.int32 and steps.tolist() == [[10, 20, 30]] * 5
    assert part.move(ids, steps).seq == part.seq


def test_layouts_of_arrays(make_scene: MakeScene) -> None:
    part, other = make_scene(), make_scene()
    rows = np.random.default_rng(1).uniform(-50, 50, (200, 3))
    part.insert(np.arange(200), rows)
    wide = np.zeros((200, 6), order="F")
    wide[::-1, ::2] = rows
    other.insert(np.arange(200, dtype=np.uint64)[::-1][::-1], wide[::-1, ::2])
    assert part.mass_properties.exact == other.mass_properties.exact
    one = make_scene()
    one.insert(7, [1, 2, 3])
    assert one.cubes()[1].tolist() == [[1, 2, 3]]


def test_centres(make_scene: MakeScene) -> None:
    part = make_scene(3, anchor="center", steps_per_unit=1)
    part.insert([1], [[1.5, 1.5, 1.5]])
    part.insert([2], np.array([[3, 0, 0]]))
    assert part.mass_properties.bounds == ((0, 0, 0), (6, 3, 3))
    assert part.cubes()[1].tolist() == [[1.5, 1.5, 1.5], [4.5, 1.5, 1.5]]


@pytest.mark.parametrize("ids", [[2**64 - 2, 0], np.array([2**64 - 2, 0], dtype=np.uint64)])
def test_large_ids(make_scene: MakeScene, ids: ArrayLike) -> None:
    part = make_scene()
    part.insert(ids, [[0, 0, 0], [10, 0, 0]])
    assert part.cubes()[0].tolist() == [0, 2**64 - 2]
    found = part.contains([[1, 1, 1], [11, 1, 1]])
    assert found.held.tolist() == [True, True] and found.id.tolist() == [2**64 - 2, 0]


def test_the_scene_gives_ids(make_scene: MakeScene) -> None:
    part = make_scene()
    assert part.insert(None, THREE).ids.tolist() == [1, 2, 3]
    assert part.insert([9], [[0, 0, 0]]).ids.size == 0
    assert part.insert(None, [[1, 0, 0]] * 5, chunk=2).ids.tolist() == [10, 11, 12, 13, 14]


def test_bad_ids_and_positions_are_named(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    before = part.mass_properties
    cases: list[tuple[Any, Any, str, object]] = [
        ([4, -5], [[0, 0, 0]] * 2, "ids[1]", -5),
        ([4, 2**64], [[0, 0, 0]] * 2, "ids[1]", 2**64),
        ([4, 5], [[0, 0, 0], [0, 2e6, 0]], "corners[1, 1]", 2e6),
        ([4, 5], [[0, 0, 0], [0, 0, float("nan")]], "corners[1, 2]", "NaN"),
        ([4, 5], np.array([[0, 0, 0], [2**31, 0, 0]]), "corners[1, 0]", 2**31),
        ([4, 4], [[0, 0, 0], [1, 0, 0]], "ids[1]", 4),
        ([4, 5, 6], [[0, 0, 0], [1, 0, 0]], "ids", None),
        ([4.5], [[0, 0, 0]], "ids[0]", 4.5),
        (np.array([4.5]), [[0, 0, 0]], "ids", None),
        ([4], [[0, 0]], "corners", None),
        ([4], [["a", "b", "c"]], "corners", None),
    ]
    for ids, corners, place, value in cases:
        with pytest.raises(union3d.InvalidInput) as refused:
            part.insert(ids, corners)
        assert [(fault.place, fault.value) for fault in refused.value.faults] == [(place, value)], str(refused.value)
        assert str(refused.value).startswith(place) and isinstance(refused.value, ValueError)
    assert part.mass_properties == before


def test_a_hundred_faults_are_named_at_once(make_scene: MakeScene) -> None:
    part = make_scene()
    with pytest.raises(union3d.InvalidInput) as refused:
        part.insert(np.arange(70), np.full((70, 3), np.inf))
    assert len(refused.value.faults) == 100
    assert refused.value.faults[99].place == "corners[33, 0]"
    assert "99 other faults" in str(refused.value)


def test_an_id_at_another_place_is_a_conflict(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    with pytest.raises(union3d.Conflict) as refused:
        part.insert([4, 3], [[0, 0, 0], [1, 2, 3]])
    assert refused.value.code == "id-conflict" and refused.value.status == 409
    assert refused.value.faults[0].place == "ids[1]"
    assert refused.value.faults[0].value == {"id": 3, "at": [1.0, 2.0, 3.0]}
    assert (part.seq, len(part)) == (1, 3)


def test_rounding_that_rejects(make_scene: MakeScene) -> None:
    part = make_scene(6, rounding="reject", steps_per_unit=2)
    part.insert([1], [[0.5, 0, 0]])
    with pytest.raises(union3d.InvalidInput, match=r"corners\[0, 0\] .* off the lattice"):
        part.insert([2], [[0.25, 0, 0]])


def test_settings_are_checked_with_their_place(make_scene: MakeScene) -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"edge": 0.0005}, "edge"),
        ({"edge": float("inf")}, "edge"),
        ({"unit": ""}, "unit"),
        ({"density": 0}, "density"),
        ({"anchor": "middle"}, "anchor"),
        ({"stock": ([0, 0, 0], [1, 1, 0])}, "stock.max[2]"),
    ]
    for settings, place in cases:
        with pytest.raises(union3d.InvalidInput) as refused:
            make_scene(**{"edge": 6, **settings})
        assert refused.value.faults[0].place == place, str(refused.value)


def test_what_is_cut_from_a_stock(make_scene: MakeScene) -> None:
    part = make_scene(6, stock=([0, 0, -10], [80, 60, 0]))
    change = part.insert([1, 2], [[0, 0, -6], [-3, 0, -3]])
    assert change.volume_removed == 216.0
    removed, remaining = part.mass_properties.removed, part.mass_properties.remaining
    assert removed is not None and remaining is not None
    assert removed.volume == 216.0 and remaining.volume == 80 * 60 * 10 - 216
    assert removed.exact.volume + remaining.exact.volume == 48_000 * 10**9
    history = part.history()
    assert history["removed"].tolist() == [216.0] and history["remaining"].tolist() == [47_784.0]


def test_a_change_is_atomic(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    change = part.change(delete=[3], insert=([4], [[30, 0, 0]]), move=17, duration=0.5)
    assert (change.inserted, change.deleted, part.seq) == (1, 1, 2)
    with pytest.raises(union3d.Conflict):
        part.change(delete=[1], insert=([2], [[30, 0, 0]]))
    assert len(part) == 3
    assert part.change(move=18, duration=0.25).seq == 3
    history = part.history()
    assert history.seq.tolist() == [1, 2, 3]
    assert np.ma.getmaskarray(history.move).tolist() == [True, False, False] and history.move[1:].tolist() == [17, 18]
    assert np.isnan(history.duration[0]) and history.duration[1:].tolist() == [0.5, 0.25]
    assert history.inserted.tolist() == [3, 1, 0] and history.deleted.tolist() == [0, 1, 0]
    assert history.volume.tolist() == [540.0, 540.0, 540.0]
    assert history.volume_exact.tolist() == [540 * 10**9] * 3
    assert history.time.dtype == np.dtype("datetime64[ms]") and np.all(np.diff(history.time) >= np.timedelta64(0, "ms"))
    assert part.history(move_from=18)["seq"].tolist() == [3]
    assert part.history(2, 3, limit=1)["seq"].tolist() == [2]
    with pytest.raises(union3d.InvalidInput, match="duration"):
        part.change(duration=-1)
    with pytest.raises(union3d.InvalidInput, match="move"):
        part.change(move=-1)


def test_a_dry_run_does_nothing(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    before = part.mass_properties
    foreseen = part.dry_run(delete=[3], insert=([4], [[6, 0, 0]]))
    assert foreseen.dry_run and foreseen.mass_properties.volume == 432.0 and foreseen.mass_properties.seq is None
    assert part.mass_properties == before
    done = part.change(delete=[3], insert=([4], [[6, 0, 0]]))
    assert done.volume_removed == foreseen.volume_removed == -108.0
    assert part.mass_properties.exact == foreseen.mass_properties.exact


def test_a_batch_is_one_change(make_scene: MakeScene) -> None:
    part = make_scene(1)
    part.insert([1, 2], [[0, 0, 0], [9, 0, 0]])
    with part.batch(move=5) as batch:
        batch.insert([3, 4], [[1, 0, 0], [2, 0, 0]])
        batch.delete([4, 1])
        batch.move([2], [[3, 0, 0]])
        assert part.seq == 1
    assert (batch.change.inserted, batch.change.deleted, part.seq) == (2, 2, 2)
    assert part.cubes()[0].tolist() == [2, 3]
    with pytest.raises(KeyError), part.batch() as lost:
        lost.delete([2])
        raise KeyError
    assert len(part) == 2


def test_going_back_and_forth(make_scene: MakeScene) -> None:
    part = make_scene()
    part.insert([1, 2, 3], THREE)
    first = part.mass_properties
    part.change(delete=[1], insert=([4], [[50, 0, 0]]))
    second = part.mass_properties
    assert part.revert(1).seq == 3
    assert part.mass_properties.exact == first.exact
    assert part.revert(2).inserted == 1
    assert part.mass_properties.exact == second.exact
    assert part.revert(4).seq == 4
    assert part.mass_properties_at(1) == first
    assert part.mass_properties_at(0).volume == 0.0
    for ask in (part.revert, part.mass_properties_at):
        with pytest.raises(union3d.NotFound, match="has not come") as refused:
            ask(9)
        assert refused.value.document["newest"] == 4


def test_where_points_lie(make_scene: MakeScene) -> None:
    part = make_scene(2)
    part.insert([7, 8], [[0, 0, 0], [2, 0, 0]])
    found = part.contains([[1, 1, 1], [2, 1, 1], [4, 1, 1], [5, 1, 1]])
    sides = union3d.Side
    assert found.side.tolist() == [sides.INSIDE, sides.INSIDE, sides.BOUNDARY, sides.OUTSIDE]
    assert found.held.tolist() == [True, True, True, False]
    assert found.id.tolist() == [7, 7, 8, 0]
    assert part.contains(np.array([[1000, 1000, 1000]])).side.tolist() == [sides.INSIDE]
    with pytest.raises(union3d.InvalidInput):
        part.contains([[0, 0, float("inf")]])


def test_chunks_and_progress(make_scene: MakeScene) -> None:
    part, done = make_scene(), list[int]()
    rows = np.random.default_rng(2).uniform(0, 30, (25, 3))
    change = part.insert(range(25), rows, chunk=10, progress=done.append)
    assert done == [10, 10, 5] and (change.inserted, change.seq) == (25, 3)
    assert change.exact_volume_removed == part.mass_properties.exact.volume
    assert part.delete(range(25), chunk=7).deleted == 25
    with pytest.raises(union3d.InvalidInput, match="chunk"):
        part.delete([1], chunk=0)


def test_an_interruption_comes_between_chunks(make_scene: MakeScene) -> None:
    part = make_scene()

    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        part.insert(range(9), np.zeros((9, 3)), chunk=4, progress=interrupt)
    assert len(part) == 4
    assert part.insert(range(9), np.zeros((9, 3)), chunk=4).unchanged == 4


def test_threads_share_a_scene(make_scene: MakeScene) -> None:
    part = make_scene()

    def work(thread: int) -> None:
        for step in range(10):
            part.insert([100 * thread + step], [[step, thread, 0]])

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (part.seq, len(part), part.audit()) == (40, 40, 40)


def test_answers_can_be_pickled_compared_and_shown(make_scene: MakeScene) -> None:
    part = make_scene()
    change = part.insert([1, 2, 3], THREE)
    for answer in (part.mass_properties, change, part.mass_properties.exact):
        copy = pickle.loads(pickle.dumps(answer))
        assert copy == answer and hash(copy) == hash(answer) and repr(copy) == repr(answer)
    assert "540 mm³" in repr(part.mass_properties) and "540 mm³" in part.mass_properties._repr_html_()
    assert "3" in repr(change) and "cubes of 6 mm" in repr(part)
    history = part.history()
    assert pickle.loads(pickle.dumps(history))["volume"].tolist() == [540.0]
    assert "1 changes" in repr(history) and history._repr_html_().count("<tr>") == 2
    with pytest.raises(AttributeError, match="no column wrong"):
        _ = history.wrong
    with pytest.raises(union3d.Conflict) as refused:
        part.insert([1], [[9, 9, 9]])
    again = pickle.loads(pickle.dumps(refused.value))
    assert str(again) == str(refused.value) and again.faults == refused.value.faults


def test_settings_are_told(make_scene: MakeScene) -> None:
    part = make_scene(2.5, steps_per_unit=10, unit="in", density=2, stock=([0, 0, 0], [5, 5, 5]))
    assert (part.edge, part.steps_per_unit, part.unit) == (2.5, 10, "in")
    assert part.settings == {
        "edge": 2.5,
        "steps_per_unit": 10,
        "unit": "in",
        "density": 2,
        "anchor": "corner",
        "rounding": "nearest",
        "stock": {"min": [0, 0, 0], "max": [5, 5, 5]},
    }


def test_a_closed_scene_refuses(make_scene: MakeScene) -> None:
    part = make_scene()
    with part:
        part.insert([1], [[0, 0, 0]])
    with pytest.raises(ValueError, match="closed"):
        len(part)
    part.close()
