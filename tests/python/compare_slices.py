"""Slices as `union3d serve` answers them, against unions of the same sections by shapely (GEOS).

    compare_slices.py UNION3D [SCENES]

Random cubes on a small lattice, where ties are common, and random convex hulls. Of hulls the section is computed here in floats: area and
perimeter must agree to 1e-9 of their size, and the polygons must be valid in the sense of OGC. Seeds are printed.
"""

import json
import random
import subprocess
import sys
import tempfile
import urllib.request

import shapely

TOLERANCE = 1e-9


def asked(base, method, path, body=None):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(base + path, data, {"content-type": "application/json"}, method=method)
    with urllib.request.urlopen(request) as answer:
        return json.loads(answer.read())


def section(points, at):
    """The section of the hull of points: the hull of where lines between those on either side go through."""
    below, above = [p for p in points if p[2] <= at], [p for p in points if p[2] > at]
    through = []
    for x0, y0, z0 in below:
        for x1, y1, z1 in above:
            part = (at - z0) / (z1 - z0)
            through.append((x0 + (x1 - x0) * part, y0 + (y1 - y0) * part))
    return shapely.MultiPoint(through).convex_hull if through else shapely.Polygon()


def compare(slice_, wanted, what):
    polygons = [shapely.Polygon(one["outer"], one["holes"]) for one in slice_["polygons"]]
    for polygon in polygons:
        assert polygon.is_valid, f"{what}: {shapely.is_valid_reason(polygon)}"
        assert polygon.exterior.is_ccw and not any(hole.is_ccw for hole in polygon.interiors), what
    found = shapely.MultiPolygon(polygons)
    assert found.is_valid, f"{what}: {shapely.is_valid_reason(found)}"
    pairs = [(slice_["area"], wanted.area), (slice_["perimeter"], wanted.length), (found.area, wanted.area)]
    for one, other in pairs:
        assert abs(one - other) <= TOLERANCE * max(1.0, abs(other)), f"{what}: {one} is not {other}"
    apart = found.symmetric_difference(wanted).area
    assert apart <= TOLERANCE * max(1.0, wanted.length), f"{what}: {apart} apart"


def cubes(base, seed, choose):
    edge, side, path = choose.randint(1, 4), 12, f"/v1/scenes/cubes{seed}"
    stock = {"min": [1, 1, 1], "max": [10, 11, 9]}
    asked(base, "PUT", path, {"edge": edge, "steps_per_unit": 1, "stock": stock})
    places = [[choose.randint(0, side) for _ in range(3)] for _ in range(choose.randint(1, 150))]
    asked(base, "POST", f"{path}/changes", {"insert": [{"id": i, "at": at} for i, at in enumerate(places)]})
    for _ in range(4):
        at = choose.randint(0, side + 4) + choose.choice([0, 0.5])
        squares = [shapely.box(x, y, x + edge, y + edge) for x, y, z in places if z <= at < z + edge]
        union = shapely.union_all(squares)
        block = shapely.box(1, 1, 10, 11) if 1 <= at < 9 else shapely.Polygon()
        parts = {"union": union, "removed": union.intersection(block), "remaining": block.difference(union)}
        for part, wanted in parts.items():
            # What GEOS keeps of touching alone has no area.
            wanted = wanted.buffer(0)
            compare(asked(base, "GET", f"{path}/slice?at={at}&part={part}"), wanted, f"seed {seed} {part} at {at}")


def hulls(base, seed, choose):
    path = f"/v1/scenes/hulls{seed}"
    asked(base, "PUT", path, {"kind": "solids", "steps_per_unit": 1000})
    bodies = []
    for _ in range(choose.randint(1, 60)):
        centre = [choose.uniform(-30, 30) for _ in range(3)]
        points = [[round(c + choose.uniform(-12, 12), 3) for c in centre] for _ in range(choose.randint(4, 16))]
        bodies.append(points)
    asked(base, "POST", f"{path}/changes", {"insert": [{"id": i, "hull": hull} for i, hull in enumerate(bodies)]})
    for _ in range(4):
        at = choose.uniform(-40, 40)
        wanted = shapely.union_all([section(points, at) for points in bodies])
        compare(asked(base, "GET", f"{path}/slice?at={at!r}"), wanted, f"seed {seed} at {at}")


def main(program, scenes=40):
    with tempfile.TemporaryDirectory() as data:
        command = [program, "serve", "--data", data, "--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0", "--log-filter", "error"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                # listening http://ADDRESS grpc://ADDRESS
                base = server.stdout.readline().split()[1]
                for seed in range(1, int(scenes) + 1):
                    for scene in (cubes, hulls):
                        scene(base, seed, random.Random(seed))
            finally:
                server.terminate()
    print(f"{scenes} scenes of cubes and as many of hulls: their slices are shapely's")


if __name__ == "__main__":
    main(*sys.argv[1:])
