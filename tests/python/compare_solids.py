"""Unions of solids as `union3d measure` says them, against Manifold's unions measured by trimesh.

    compare_solids.py UNION3D [SCENES]

Sound inputs only: random convex bodies in general position, and what some of them sweep along random segments, for which floating point has no ties
to break. Volume, area, edge length, centre of mass and inertia must agree to 1e-9 of their size. Seeds are printed; the same seed makes the
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
    return scene


def user(points):
    return [[at / STEPS_PER_UNIT for at in point] for point in points]


def of_union3d(program, scene):
    lines = []
    for number, (points, start, end) in enumerate(scene):
        start, end = user([start, end])
        lines.append({"shapes": {f"s{number}": {"hull": user(points)}}})
        way = {"at": start} if start == end else {"from": start, "to": end}
        lines.append({"shape": f"s{number}", **way})
    command = [program, "measure", "-", "--kind", "solids", "--json", "--steps-per-unit", str(STEPS_PER_UNIT)]
    text = "\n".join(json.dumps(line) for line in lines)
    output = subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout
    found = json.loads(output)
    return {
        "volume": found["volume"],
        "area": found["area"],
        "edge length": found["edge_length"]["total"],
        "centroid": found["centroid"],
        "inertia": found["inertia"],
    }


def of_strangers(scene):
    hulls = []
    for points, start, end in scene:
        ends = [numpy.array(points, dtype=float) + numpy.array(place) for place in (start, end)]
        hulls.append(manifold3d.Manifold.hull_points(numpy.concatenate(ends) / STEPS_PER_UNIT))
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    mesh = union.to_mesh64()
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
        scene = bodies(seed)
        ours, theirs = of_union3d(program, scene), of_strangers(scene)
        for name, value in ours.items():
            value, other = numpy.array(value), numpy.array(theirs[name])
            # A centroid near the origin has no size of its own: the scene is about 50 units large.
            size = max(numpy.abs(other).max(), 50.0 if name == "centroid" else 0.0)
            error = numpy.abs(value - other).max() / size
            assert error < TOLERANCE, f"seed {seed}: {name} is {value}, and to the others {other}"
            worst[name] = max(worst.get(name, 0.0), error)
    for name, error in worst.items():
        print(f"{name}: within {error:.1e} in {scenes} scenes")


if __name__ == "__main__":
    main()
