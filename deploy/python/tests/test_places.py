"""What only some places have: how many changes memory keeps, directories and their locks, servers that go away."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import Server

import union3d


def test_memory_keeps_the_newest_changes() -> None:
    part = union3d.Scene(1, history=2)
    for number in range(5):
        part.insert([number], [[number, 0, 0]])
    assert part.history()["seq"].tolist() == [4, 5]
    assert part.mass_properties_at(3).volume == 3.0
    with pytest.raises(union3d.NotFound) as refused:
        part.mass_properties_at(2)
    assert (refused.value.code, refused.value.document["oldest"]) == ("seq-not-kept", 3)
    with pytest.raises(union3d.NotFound) as refused:
        part.revert(2)
    assert (refused.value.code, refused.value.document["oldest"]) == ("seq-not-reachable", 3)
    part.revert(3)
    assert part.mass_properties.volume == 3.0
    forgetful = union3d.Scene(1, history=0)
    forgetful.insert([1], [[0, 0, 0]])
    assert forgetful.mass_properties_at(1).volume == 1.0 and forgetful.history()["seq"].size == 0
    with pytest.raises(union3d.InvalidInput, match="history"):
        union3d.Scene(1, history=-1)


def test_a_directory_keeps_its_scene(tmp_path: Path) -> None:
    with union3d.open(tmp_path / "data/part", 6) as part:
        part.insert([1, 2], [[0, 0, 0], [3, 0, 0]])
        kept = part.mass_properties
    with union3d.open(tmp_path / "data/part") as part:
        assert part.name == "part" and part.mass_properties == kept
        assert part.history()["seq"].tolist() == [1]
    with pytest.raises(union3d.Conflict) as refused:
        union3d.open(tmp_path / "data/part", 7)
    assert refused.value.document["settings"]["edge"] == 6
    with pytest.raises(union3d.NotFound, match="give the edge"):
        union3d.open(tmp_path / "data/other")
    with pytest.raises(union3d.InvalidInput, match="name"):
        union3d.open(tmp_path / "data/Part", 6)


def test_scenes_of_one_process_share_a_directory(tmp_path: Path) -> None:
    with union3d.open(tmp_path / "one", 6) as one, union3d.open(tmp_path / "two", 6) as two:
        one.insert([1], [[0, 0, 0]])
        with union3d.open(tmp_path / "one") as same:
            assert len(same) == 1 and len(two) == 0


OTHER = "import sys, union3d; print(len(union3d.open(sys.argv[1])))"


def test_a_directory_is_locked_while_a_scene_is_open(tmp_path: Path) -> None:
    def other() -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", OTHER, tmp_path / "part"], capture_output=True, text=True)

    part, second = union3d.open(tmp_path / "part", 6), union3d.open(tmp_path / "second", 6)
    part.insert([1], [[0, 0, 0]])
    part.close()
    refused = other()
    assert refused.returncode == 1 and "Unavailable" in refused.stderr and str(tmp_path) in refused.stderr
    second.close()
    assert other().stdout == "1\n"


def test_a_scene_that_is_forgotten_lets_go(tmp_path: Path) -> None:
    part = union3d.open(tmp_path / "part", 6)
    del part
    done = subprocess.run([sys.executable, "-c", OTHER, tmp_path / "part"], capture_output=True, text=True)
    assert done.stdout == "0\n", done.stderr


def test_a_server_has_the_same_directory(tmp_path: Path) -> None:
    with union3d.open(tmp_path / "part", 6) as part:
        part.insert([1, 2], [[0, 0, 0], [3, 0, 0]])
        kept = part.mass_properties
    server = Server(tmp_path)
    try:
        with union3d.connect(f"{server.url}/part") as part:
            assert part.mass_properties == kept
            with pytest.raises(union3d.Unavailable):
                union3d.open(tmp_path / "part")
    finally:
        server.stop()


def test_addresses_are_checked(server: Server) -> None:
    for url, what in [
        ("part", "is no address"),
        ("ftp://127.0.0.1/part", "begins with neither http"),
        (server.url + "/", "name of a scene"),
        (server.url + "/Part", "name"),
    ]:
        with pytest.raises(union3d.InvalidInput, match=what):
            union3d.connect(url, 6)
    with pytest.raises(union3d.NotFound, match="there is no scene"):
        union3d.connect(f"{server.url}/not-there")


def test_nobody_answers(tmp_path: Path) -> None:
    server = Server(tmp_path)
    server.stop()
    with pytest.raises(union3d.Unavailable, match="is the server running"):
        union3d.connect(f"{server.url}/part", 6)
