"""Meshes of scenes as the server answers them, loaded by trimesh and Manifold, against the mass properties of the same scenes.

    compare_meshes.py UNION3D [SCENES]

Scenes of cubes on small lattices, where ties are the common case, and small milled ones of solids, each with and without a stock; every part, in
every format. Where a part is a manifold both must call its mesh watertight. Volume, area, centroid, inertia and Euler characteristic must agree to 1e-9 where
the format has 64 bits, and to 1e-5 in STL and GLB. Seeds are printed; the same seed makes the same scene everywhere.
"""

import collections
import io
import json
import random
import subprocess
import sys
import tempfile
import urllib.request

import manifold3d
import numpy
import trimesh

TOLERANCES = {"ply": 1e-9, "obj": 1e-9, "3mf": 1e-9, "stl": 1e-5, "glb": 1e-5}


class Server:
    def __init__(self, program):
        self.data = tempfile.TemporaryDirectory()
        command = [program, "serve", "--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0", "--log-filter", "error", "--data", self.data.name]
        self.child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self.url = self.child.stdout.readline().split()[1]

    def ask(self, method, path, body=None):
        body = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, method=method, data=body, headers={"content-type": "application/json"})
        with urllib.request.urlopen(request) as answer:
            return answer.read()

    def end(self):
        self.child.kill()
        self.child.wait()
        self.data.cleanup()


def cubes(choose):
    world = choose.randint(1, 6)
    settings = {"edge": choose.randint(1, 4), "steps_per_unit": choose.choice([1, 3, 1000]) * 4}
    settings["edge"] /= 4
    at = lambda: [choose.randint(-world, world) / 4 for _ in range(3)]
    insert = [{"id": id, "at": at()} for id in range(choose.choice([1, 5, 30, 100]))]
    return settings, at, insert


def solids(choose):
    shapes = {"flat": {"flat": {"diameter": 3, "length": 12, "sides": choose.choice([4, 7, 16])}}, "box": {"box": [2, 1, 3]}}
    settings = {"kind": "solids", "steps_per_unit": 100, "shapes": shapes}
    at = lambda: [choose.randint(-5, 5), choose.randint(-5, 5), choose.randint(-3, 0)]
    insert, here = [], at()
    for id in range(choose.choice([1, 4, 12])):
        there = at()
        insert.append({"id": id, "shape": choose.choice(["flat", "flat", "box"]), "from": here, "to": there})
        here = there
    return settings, at, insert


def parts(properties):
    """The measures of each part by its name."""
    found = {"removed": properties.get("removed"), "remaining": properties.get("remaining")}
    if "solids" not in properties:
        found["union"] = properties
    elif found["remaining"] is None:
        found["union"] = properties
    return {name: measures for name, measures in found.items() if measures is not None}


def field(measures, name):
    for place in (measures.get("user", {}), measures.get("integers", {}), measures):
        if name in place:
            return place[name]
    return None


def is_manifold(faces):
    """Whether every edge has two triangles, and those around every vertex are one ring."""
    by_edge = collections.Counter(tuple(sorted(edge)) for face in faces for edge in zip(face, numpy.roll(face, -1)))
    if any(count != 2 for count in by_edge.values()):
        return False
    around = collections.defaultdict(dict)
    for a, b, c in faces:
        for at, one, other in ((a, b, c), (b, c, a), (c, a, b)):
            around[at][one] = other
    for links in around.values():
        first = next(iter(links))
        here, count = links[first], 1
        while here != first:
            here, count = links[here], count + 1
        if count != len(links):
            return False
    return True


def rounding(measures, name):
    return measures.get("error_max", {}).get(name, 0.0)


def check(context, form, mesh, measures, size):
    tolerance = TOLERANCES[form]
    volume = field(measures, "volume")
    found = {"volume": mesh.volume, "area": mesh.area}
    expected = {"volume": volume, "area": field(measures, "area")}
    if volume:
        found |= {"centroid": mesh.center_mass, "inertia": mesh.moment_inertia}
        expected |= {"centroid": field(measures, "centroid"), "inertia": field(measures, "inertia")}
    for name, value in found.items():
        if expected[name] is None:
            continue
        value, other = numpy.array(value), numpy.array(expected[name])
        scale = max(numpy.abs(other).max(), size if name == "centroid" else 1e-3)
        # The totals of solids are rounded, flag by flag, and say by how much at most.
        error = numpy.abs(value - other).max() - rounding(measures, name)
        assert error < tolerance * scale, f"{context}, {form}: {name} is {value}, and by the mass properties {other}"


def main():
    program, scenes = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 60
    server = Server(program)
    counts = collections.Counter()
    try:
        for seed in range(scenes):
            print(f"seed {seed}", flush=True)
            choose = random.Random(seed)
            settings, at, insert = (cubes if seed % 2 == 0 else solids)(choose)
            if choose.random() < 0.6:
                one, other = at(), at()
                low = [min(pair) for pair in zip(one, other)]
                settings["stock"] = {"min": low, "max": [max(pair) + 0.25 for pair in zip(one, other)]}
            path = f"/v1/scenes/s{seed}"
            server.ask("PUT", path, settings)
            server.ask("POST", f"{path}/changes", {"insert": insert})
            properties = json.loads(server.ask("GET", f"{path}/mass-properties"))
            for part, measures in parts(properties).items():
                context = f"seed {seed}, {part}"
                for form in TOLERANCES:
                    text = server.ask("GET", f"{path}/mesh?part={part}&format={form}")
                    if field(measures, "volume") == 0:
                        counts["empty"] += 1
                        continue
                    joined = form in ("stl", "glb")
                    mesh = trimesh.load(io.BytesIO(text), file_type=form, force="mesh", process=False)
                    if joined:
                        vertices, faces = numpy.unique(mesh.vertices.reshape(-1, 3), axis=0, return_inverse=True)
                        mesh = trimesh.Trimesh(vertices, faces.reshape(-1)[mesh.faces.reshape(-1)].reshape(-1, 3), process=False)
                    check(context, form, mesh, measures, 5.0)
                    if not is_manifold(mesh.faces):
                        counts["touching itself"] += 1
                        continue
                    counts["watertight"] += 1
                    assert mesh.is_watertight and mesh.is_winding_consistent, f"{context}, {form}: not watertight"
                    euler = field(measures, "euler_characteristic")
                    if euler is not None:
                        assert mesh.euler_number == 2 * euler, f"{context}, {form}: Euler number {mesh.euler_number} and {euler}"
                        counts["Euler characteristics"] += 1
                    if form == "ply":
                        theirs = manifold3d.Manifold(manifold3d.Mesh64(numpy.array(mesh.vertices), numpy.array(mesh.faces, dtype=numpy.uint64)))
                        assert theirs.status() == manifold3d.Error.NoError, f"{context}: Manifold says {theirs.status()}"
                        volume = field(measures, "volume")
                        assert abs(theirs.volume() - volume) < 1e-9 * volume + rounding(measures, "volume"), f"{context}: {theirs.volume()} and {volume}"
                        counts["taken by Manifold"] += 1
    finally:
        server.end()
    print(", ".join(f"{count} {name}" for name, count in counts.items()))
    assert counts["watertight"] > scenes and counts["taken by Manifold"] > scenes / 4, "most meshes are manifolds"


if __name__ == "__main__":
    main()
