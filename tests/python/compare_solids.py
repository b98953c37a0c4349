"""Unions of solids as `union3d measure` says them, against Manifold's unions measured by trimesh.

    compare_solids.py UNION3D [SCENES]

Sound inputs only: random convex bodies in general position, and what some of them sweep along random segments, for which floating point has no ties
to break. Of every other scene what they remove from a random convex stock, and what remains of it. Volume, area, edge length, centre of mass and inertia must agree to 1e-9 of their size. Seeds are printed; the same seed makes the
same scene everywhere.
"""

import json
import random
import subprocess
import sys

import manifold3d
import numpy
import trimesh

STEPS_PER_UNIT = 1000
TOLERANCE = 1e-9
# Below this angle between two triangles they are one face.
FLAT_ANGLE = 1e-6


def bodies(seed):
    """Vertices of bodies around an anchor, and the two ends of the anchor's way (the same for a body that stays), in lattice steps."""
    choose = random.Random(seed)
    at = lambda size: [choose.randint(-size, size) for _ in range(3)]
    scene = []
    for _ in range(choose.randint(1, 25)):
        size = choose.choice([2_000, 10_000, 30_000])
        points = [at(size) for _ in range(choose.randint(4, 20))]
        start = at(20_000)
        end = at(20_000) if choose.random() < 0.5 else start
        scene.append((points, start, end))
    stock = [at(25_000) for _ in range(12)] if seed % 2 else None
    return scene, stock


def user(points):
    return [[at / STEPS_PER_UNIT for at in point] for point in points]


def of_union3d(program, scene, stock):
    lines = []
    for number, (points, start, end) in enumerate(scene):
        start, end = user([start, end])
        lines.append({"shapes": {f"s{number}": {"hull": user(points)}}})
        way = {"at": start} if start == end else {"from": start, "to": end}
        lines.append({"shape": f"s{number}", **way})
    command = [program, "measure", "-", "--kind", "solids", "--json", "--steps-per-unit", str(STEPS_PER_UNIT)]
    if stock:
        command.append("--stock=hull:" + ":".join(",".join(map(str, point)) for point in user(stock)))
    text = "\n".join(json.dumps(line) for line in lines)
    output = subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout
    found = json.loads(output)
    return {part: measures(found[part]) for part in ("removed", "remaining")} if stock else {"union": measures(found)}


def measures(found):
    return {
        "volume": found["volume"],
        "area": found["area"],
        "edge length": found["edge_length"]["total"],
        "centroid": found["centroid"],
        "inertia": found["inertia"],
    }


def of_strangers(scene, stock):
    hulls = []
    for points, start, end in scene:
        ends = [numpy.array(points, dtype=float) + numpy.array(place) for place in (start, end)]
        hulls.append(manifold3d.Manifold.hull_points(numpy.concatenate(ends) / STEPS_PER_UNIT))
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    if not stock:
        return {"union": measures_of_mesh(union.to_mesh64())}
    stock = manifold3d.Manifold.hull_points(numpy.array(stock, dtype=float) / STEPS_PER_UNIT)
    return {"removed": measures_of_mesh((stock ^ union).to_mesh64()), "remaining": measures_of_mesh((stock - union).to_mesh64())}


def measures_of_mesh(mesh):
    # Bodies that share no point stay apart: trimesh must not join vertices.
    solid = trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts, process=False)
    is_edge = solid.face_adjacency_angles > FLAT_ANGLE
    ends = solid.vertices[solid.face_adjacency_edges[is_edge]]
    return {
        "volume": solid.volume,
        "area": solid.area,
        "edge length": numpy.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum(),
        "centroid": solid.center_mass,
        "inertia": solid.moment_inertia,
    }


def main():
    program, scenes = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 100
    worst = {}
    for seed in range(scenes):
        print(f"seed {seed}", flush=True)
        scene, stock = bodies(seed)
        ours, theirs = of_union3d(program, scene, stock), of_strangers(scene, stock)
        for part, name in ((part, name) for part in ours for name in ours[part]):
            value, other = ours[part][name], theirs[part][name]
            # What has no volume has no centre of mass.
            if ours[part]["centroid"] is None and name in ("centroid", "inertia"):
                assert not theirs[part]["volume"], f"seed {seed}: {part} has no centre of mass"
                continue
            value, other = numpy.array(value), numpy.array(other)
            # A centroid near the origin has no size of its own: the scene is about 50 units large. And what is left of a stock may be small.
            size = max(numpy.abs(other).max(), {"centroid": 50.0, "volume": 1e2, "area": 1e2, "edge length": 1e2, "inertia": 1e4}[name])
            error = numpy.abs(value - other).max() / size
            assert error < TOLERANCE, f"seed {seed}: {name} of {part} is {value}, and to the others {other}"
            worst[name] = max(worst.get(name, 0.0), error)
    for name, error in worst.items():
        print(f"{name}: within {error:.1e} in {scenes} scenes")


if __name__ == "__main__":
    main()
