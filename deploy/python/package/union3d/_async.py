"""Scenes for programs that are built on asyncio."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from ._scene import Scene

__all__ = ["AsyncScene"]

P = ParamSpec("P")
R = TypeVar("R")


def _awaitable(
    method: Callable[Concatenate[Scene, P], R],
) -> Callable[Concatenate[AsyncScene, P], Coroutine[Any, Any, R]]:
    @functools.wraps(method)
    async def call(self: AsyncScene, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return await asyncio.to_thread(method, self.scene, *args, **kwargs)

    return call


class AsyncScene:
    """A `Scene` whose calls are awaited: each runs on a thread, and the event loop goes on meanwhile.

    What is cancelled while it waits may still be done, as of a request that is broken off.

    Example:
        >>> import asyncio, union3d
        >>> async def main() -> float:
        ...     async with union3d.AsyncScene(union3d.Scene(edge=6)) as part:
        ...         await part.insert([1, 2], [[0, 0, 0], [3, 0, 0]])
        ...         return (await part.mass_properties()).volume
        >>> asyncio.run(main())
        324.0
    """

    def __init__(self, scene: Scene) -> None:
        """Takes a scene as `Scene`, `union3d.open` or `union3d.connect` has made it."""
        self.scene = scene

    insert = _awaitable(Scene.insert)
    insert_sweeps = _awaitable(Scene.insert_sweeps)
    insert_hulls = _awaitable(Scene.insert_hulls)
    define = _awaitable(Scene.define)
    delete = _awaitable(Scene.delete)
    move = _awaitable(Scene.move)
    change = _awaitable(Scene.change)
    dry_run = _awaitable(Scene.dry_run)
    revert = _awaitable(Scene.revert)
    mass_properties = _awaitable(Scene.mass_properties_at)
    history = _awaitable(Scene.history)
    contains = _awaitable(Scene.contains)
    cubes = _awaitable(Scene.cubes)
    solids = _awaitable(Scene.solids)
    audit = _awaitable(Scene.audit)
    close = _awaitable(Scene.close)

    async def __aenter__(self) -> AsyncScene:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        await self.close()
