"""Scenes whose calls are awaited, and measuring without one."""

from __future__ import annotations

import asyncio

import pytest
from conftest import MakeScene

import union3d


def test_calls_are_awaited(make_scene: MakeScene) -> None:
    async def work() -> None:
        async with union3d.AsyncScene(make_scene(6)) as part:
            await asyncio.gather(*(part.insert([number], [[10 * number, 0, 0]]) for number in range(8)))
            assert (await part.mass_properties()).volume == 8 * 216
            assert (await part.delete(range(4))).deleted == 4
            assert (await part.change(insert=([1], [[0, 0, 0]]), move=3)).seq == 10
            assert (await part.history()).move[-1] == 3
            assert (await part.contains([[1, 1, 1]])).id.tolist() == [1]
            assert (await part.cubes())[0].tolist() == [1, 4, 5, 6, 7]
            assert (await part.dry_run(delete=[1])).volume_removed == -216.0
            assert (await part.revert(8)).inserted == 4
            assert await part.audit() == 8
            with pytest.raises(union3d.Conflict):
                await part.solids()
        with pytest.raises(ValueError, match="closed"):
            await part.audit()

    asyncio.run(work())


def test_measuring_without_a_scene() -> None:
    done = list[int]()
    properties = union3d.measure([[0, 0, 0], [1, 0, 0]], edge=1, stock=([0, 0, 0], [4, 1, 1]), progress=done.append)
    assert (properties.volume, properties.area, done) == (2.0, 10.0, [2])
    assert properties.remaining is not None and properties.remaining.volume == 2.0
