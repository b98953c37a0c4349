"""Manifold and union3d on the same cubes and solids: see tests/bench/peers, which prepares everything and runs this."""

import argparse
import array
import contextlib
import importlib.metadata
import json
import os
import pathlib
import random
import statistics
import subprocess
import sys
import tempfile
import time

import manifold3d
import numpy

EDGE = 6_000  # steps
TOLERANCE = 1e-9
GRID = 10  # cubes along an edge of the grid


def places(count, seed):
    """Lower corners, uniformly in a box in which the cubes cover each point once on average."""
    generator = random.Random(seed)
    side = round(EDGE * count ** (1 / 3))
    return [[generator.randrange(side) for _ in range(3)] for _ in range(count)]


def grid():
    """Lower corners of cubes that touch, in the order of the benchmark: x runs first."""
    steps = range(0, GRID * EDGE, EDGE)
    return [[x, y, z] for z in steps for y in steps for x in steps]


def cube_points(corner):
    return [[corner[axis] + EDGE * (number >> axis & 1) for axis in range(3)] for number in range(8)]


def seconds(work):
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def computed(solid):
    # It computes when it is asked.
    solid.num_tri()
    return solid


def union(solids):
    return computed(manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add))


def one_by_one(solids):
    """The seconds that uniting them one after the other takes, and the union."""

    def unite():
        whole = solids[0]
        for solid in solids[1:]:
            whole = computed(whole + solid)
        return whole

    return seconds(unite)


class Manifold:
    """Medians of seconds, and volume and area of all."""

    def __init__(self, solids, runs, incremental):
        batch, more, inserts = [], [], []
        for _ in range(runs):
            # Copies, so that nothing computed before is used again.
            fresh = [solid.translate([0, 0, 0]) for solid in solids]
            took, whole = seconds(lambda: union(fresh[:-1]))
            batch.append(took)
            took, larger = seconds(lambda: computed(whole + fresh[-1]))
            more.append(took)
            if incremental:
                inserts.append(one_by_one(fresh)[0])
        self.batch, self.more = statistics.median(batch), statistics.median(more)
        self.inserts = statistics.median(inserts) if incremental else None
        self.volume, self.area = larger.volume(), larger.surface_area()


@contextlib.contextmanager
def file_of(data, suffix):
    with tempfile.NamedTemporaryFile(suffix=suffix) as file:
        file.write(data)
        file.flush()
        yield file.name


def triplets(corners):
    numbers = array.array("i", [number for corner in corners for number in corner])
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers.tobytes()


def lines(hulls):
    return "".join(json.dumps({"hull": points}) + "\n" for points in hulls).encode()


def answer(*command):
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def union3d_cubes(program, corners, runs):
    """Our side, measured in its process."""
    with file_of(triplets(corners), ".i32") as name:
        return answer(program, "peers", "--cubes", name, "--edge", str(EDGE), "--runs", str(runs))


def union3d_solids(program, hulls, runs):
    with file_of(lines(hulls), ".ndjson") as name:
        return answer(program, "peers", "--solids", name, "--runs", str(runs))


def hulls_of(program, name, count):
    """A set of solids, each as the points whose hull it is."""
    command = [program, "hulls", "--set", name, "--solids", str(count)]
    printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    return [json.loads(line)["hull"] for line in printed.splitlines()]


def differences(theirs, ours):
    """How far volume and area are off, as parts of the whole."""
    return [abs(getattr(theirs, name) / ours[name] - 1) for name in ("volume", "area")]


def check(what, theirs, ours):
    for name, off in zip(("volume", "area"), differences(theirs, ours), strict=True):
        if off > TOLERANCE:
            sys.exit(f"{name} of {what} differs by {off:.1e}")


def row(*cells):
    print("| " + " | ".join(cells) + " |", flush=True)


def compared(theirs, mine):
    return f"{theirs:.3g}", f"{mine:.3g}", f"{theirs / mine:,.0f}" if theirs >= 10 * mine else f"{theirs / mine:.1f}"


def cubes(arguments):
    row("cubes", "operation", "Manifold s", "union3d s", "times faster")
    row("--:", "---", "--:", "--:", "--:")
    for count in map(int, arguments.cubes.split(",")):
        # The last one is the one more.
        corners = places(count + 1, arguments.seed)
        ours = union3d_cubes(arguments.program, corners, 5 * arguments.runs)
        cube = manifold3d.Manifold.cube([EDGE] * 3)
        theirs = Manifold([cube.translate(corner) for corner in corners], arguments.runs, incremental=False)
        check(f"{count + 1} cubes", theirs, ours)
        row(f"{count:,}", "all in one batch", *compared(theirs.batch, ours["batch_seconds"]))
        row(f"{count:,}", "one more insert", *compared(theirs.more, ours["insert_seconds"]))
    print(f"\nVolume and area agree to {TOLERANCE:g}.\n")


def solids(arguments):
    """Sweeps and domes: Manifold unites their hulls."""
    row("solids", "operation", "Manifold s", "union3d s", "times faster", "volume off", "area off")
    row("---", "---", "--:", "--:", "--:", "--:", "--:")
    for item in filter(None, arguments.solids.split(",")):
        name, count = item.split(":")
        hulls = hulls_of(arguments.program, name, int(count))
        ours = union3d_solids(arguments.program, hulls, arguments.runs)
        made = [manifold3d.Manifold.hull_points(numpy.array(points, float)) for points in hulls]
        # A dome of thousands takes Manifold minutes one by one.
        incremental = name != "dome"
        theirs = Manifold(made, arguments.runs, incremental)
        off = [f"{part:.1e}" for part in differences(theirs, ours)]
        check(f"{count} {name}", theirs, ours)
        title = f"{int(count):,} {name}"
        row(title, "all in one batch", *compared(theirs.batch, ours["batch_seconds"]), *off)
        row(title, "one more insert", *compared(theirs.more, ours["insert_seconds"]), "", "")
        if incremental:
            row(title, "one after the other", *compared(theirs.inserts, ours["inserts_seconds"]), "", "")
        else:
            row(title, "Manifold's batch, ours one after the other", *compared(theirs.batch, ours["inserts_seconds"]), "", "")
    print()


def cube_grid(arguments):
    """1,000 cubes that touch, united one after the other, and then subtracted in the same order: nothing is left."""
    corners = grid()
    cube = manifold3d.Manifold.cube([EDGE] * 3)
    whole, left = [], None
    for _ in range(arguments.runs):
        pieces = [cube.translate(corner) for corner in corners]
        united, solid = one_by_one(pieces)

        def subtract(solid=solid, pieces=pieces):
            for piece in pieces:
                solid = computed(solid - piece)
            return solid

        subtracted, left = seconds(subtract)
        whole.append(united + subtracted)
    theirs = statistics.median(whole)
    ours = {
        "cubes": union3d_cubes(arguments.program, corners, 5 * arguments.runs),
        "solids": union3d_solids(arguments.program, [cube_points(corner) for corner in corners], 5 * arguments.runs),
    }
    row("program", "s", "left when all is subtracted")
    row("---", "--:", "---")
    row("Manifold, here", f"{theirs:.3g}", "nothing" if left.is_empty() else f"{left.volume() / EDGE**3:.3g} cubes")
    for kind, figures in ours.items():
        expected = (GRID * EDGE) ** 3
        if figures["volume"] != expected:
            sys.exit(f"the grid as {kind} has volume {figures['volume']!r}, not {expected}")
        row(f"union3d, a scene of {kind}", f"{figures['inserts_seconds'] + figures['deletes_seconds']:.3g}", "nothing")
    print()


def main():
    parser = argparse.ArgumentParser(prog="tests/bench/peers")
    parser.add_argument("--program", type=pathlib.Path, required=True)
    parser.add_argument("--cubes", default="1000,10000", help="numbers of random cubes (default 1000,10000)")
    parser.add_argument(
        "--solids",
        default="flat:1000,ball:1000,dome:1000,dome:5000",
        help="sets of solids and their numbers (default flat:1000,ball:1000,dome:1000,dome:5000)",
    )
    parser.add_argument("--runs", type=int, default=3, help="runs of each, of which the median is printed (default 3)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    version = importlib.metadata.version("manifold3d")
    load = os.getloadavg()[0]
    print(
        f"manifold3d {version}, numpy {numpy.__version__}, Python {sys.version.split()[0]}, load before {load:.2f}; "
        f"random cubes at rho 1, seed {arguments.seed}\n"
    )
    cubes(arguments)
    solids(arguments)
    cube_grid(arguments)


main()
