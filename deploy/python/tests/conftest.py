"""The same tests over the three places where a scene can be."""

from __future__ import annotations

import itertools
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import union3d

ROOT = Path(__file__).parents[3]
PROGRAM = Path(os.environ.get("SERVER_PROGRAM", ROOT / "target/debug/union3d"))

MakeScene = Callable[..., union3d.Scene]


class Server:
    """A server of our own on a free port."""

    def __init__(self, data: Path) -> None:
        self.process = subprocess.Popen(
            [PROGRAM, "serve", "--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0", "--data", data, "--log-filter", "warn"],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        greeting = self.process.stdout.readline()
        self.url = next(word for word in greeting.split() if word.startswith("http://")).rstrip(",")

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    server = Server(tmp_path_factory.mktemp("server"))
    yield server
    server.stop()


NAMES = (f"part-{number}" for number in itertools.count())


@pytest.fixture(params=["memory", "directory", "server"])
def make_scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[MakeScene]:
    """Makes scenes in one of the places, with the settings that are given."""
    made: list[union3d.Scene] = []
    data = tmp_path_factory.mktemp("data")

    def make(edge: float | None = 6, **settings: Any) -> union3d.Scene:
        match request.param:
            case "memory":
                scene = union3d.Scene(edge, **settings)
            case "directory":
                scene = union3d.open(data / next(NAMES), edge, **settings)
            case _:
                server: Server = request.getfixturevalue("server")
                scene = union3d.connect(f"{server.url}/{next(NAMES)}", edge, **settings)
        made.append(scene)
        return scene

    yield make
    for scene in made:
        scene.close()


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Says what tests/run counts."""
    count = {name: len(terminalreporter.stats.get(name, [])) for name in ("passed", "failed", "error")}
    terminalreporter.write_line(f"{count['passed']} passed, {count['failed'] + count['error']} failed")
