"""Manifold and union3d on the same cubes: see tests/bench/peers, which prepares everything and runs this."""

import argparse
import array
import importlib.metadata
import json
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


def places(count, seed):
    """Lower corners, uniformly in a box in which the cubes cover each point once on average."""
    generator = random.Random(seed)
    side = round(EDGE * count ** (1 / 3))
    return [[generator.randrange(side) for _ in range(3)] for _ in range(count)]


def seconds(work):
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def manifold(corners, runs):
    """Seconds of the union of all cubes but the last, of one more, and volume and area of all."""
    cube = manifold3d.Manifold.cube([EDGE] * 3)
    batch, more = [], []
    for _ in range(runs):
        solids = [cube.translate(corner) for corner in corners]

        def union():
            whole = manifold3d.Manifold.batch_boolean(solids[:-1], manifold3d.OpType.Add)
            # It computes when it is asked.
            whole.num_tri()
            return whole

        took, whole = seconds(union)
        batch.append(took)

        def insert():
            larger = whole + solids[-1]
            larger.num_tri()
            return larger

        took, larger = seconds(insert)
        more.append(took)
    return statistics.median(batch), statistics.median(more), larger.volume(), larger.surface_area()


def union3d(program, corners, runs):
    """The same from our side, measured in its process."""
    with tempfile.NamedTemporaryFile(suffix=".i32") as file:
        numbers = array.array("i", [number for corner in corners for number in corner])
        if sys.byteorder == "big":
            numbers.byteswap()
        file.write(numbers.tobytes())
        file.flush()
        command = [program, "peers", "--cubes", file.name, "--edge", str(EDGE), "--runs", str(runs)]
        return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)


def main():
    parser = argparse.ArgumentParser(prog="tests/bench/peers")
    parser.add_argument("--program", type=pathlib.Path, required=True)
    parser.add_argument("--cubes", default="1000,10000", help="numbers of cubes (default 1000,10000)")
    parser.add_argument("--runs", type=int, default=3, help="runs of each, of which the median is printed (default 3)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    version = importlib.metadata.version("manifold3d")
    print(f"manifold3d {version}, numpy {numpy.__version__}, Python {sys.version.split()[0]}; random cubes at rho 1, seed {arguments.seed}\n")
    print("| cubes | operation | Manifold s | union3d s | times faster |\n| --: | --- | --: | --: | --: |")
    for count in map(int, arguments.cubes.split(",")):
        # The last one is the one more.
        corners = places(count + 1, arguments.seed)
        ours = union3d(arguments.program, corners, 5 * arguments.runs)
        batch, more, volume, area = manifold(corners, arguments.runs)
        for name, theirs in (("volume", volume), ("area", area)):
            off = abs(theirs / ours[name] - 1)
            if off > TOLERANCE:
                sys.exit(f"{name} of {count + 1} cubes: {theirs!r} and {ours[name]!r} differ by {off:.1e}")
        for operation, theirs, mine in (("all in one batch", batch, ours["batch_seconds"]), ("one more insert", more, ours["insert_seconds"])):
            print(f"| {count:,} | {operation} | {theirs:.3g} | {mine:.3g} | {theirs / mine:,.0f} |", flush=True)
    print(f"\nVolume and area agree to {TOLERANCE:g}.")


main()
