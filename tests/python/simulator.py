"""A simulator as a client: streams the lines of a program into a scene with a stock, and shows what each line removes.

A complete client for those who write one. It needs grpcio and protobuf, and the code that grpcio-tools makes of the proto files:

    python -m grpc_tools.protoc -I proto --python_out=. --grpc_python_out=. proto/union3d/v1/*.proto
    python simulator.py --server 127.0.0.1:7374

The cutter is a cube of 6 mm that mills a pocket, line by line; a line is one change, with its number and its machine time.
"""

import argparse
import queue
import sys
import time
import uuid

import grpc

from union3d.v1 import union3d_pb2 as messages
from union3d.v1 import union_service_pb2 as calls
from union3d.v1 import union_service_pb2_grpc as service

EDGE = 6.0  # mm
STEPS = 1000  # lattice steps in a mm
STEP = 0.5  # mm between two positions of the cutter
FEED = 20.0  # mm in a second
WINDOW = 32  # lines sent ahead of their acknowledgements
PATIENCE = 60.0  # seconds that a server which went away is waited for


def program():
    """The lines of a program: number, where from and where to. A pocket in five layers, each milled to and fro."""
    here, number = (0.0, 0.0, 5.0), 0
    for layer in range(5):
        depth = -1.0 - layer
        corners = [(0.0, 0.0, depth)]
        for row in range(10):
            side = 60.0 if row % 2 == 0 else 0.0
            corners.append((side, 4.0 * row, depth))
            if row < 9:
                corners.append((side, 4.0 * (row + 1), depth))
        for there in corners:
            number += 1
            yield number, here, there
            here = there


def sweep(number, start, end):
    """A line as a change: the cubes of the cutter on the way, its number, and its time."""
    way = [b - a for a, b in zip(start, end)]
    length = sum(step * step for step in way) ** 0.5
    count = max(1, round(length / STEP))
    change = messages.Change(move=number, duration=length / FEED)
    for index in range(1, count + 1):
        centre = [a + step * index / count for a, step in zip(start, way)]
        x, y, z = (round((at - EDGE / 2) * STEPS) for at in centre)
        # Ids are the simulator's own: sent again after a broken connection, a cube that is there changes nothing.
        change.insert_id.append(number * 10_000 + index)
        change.x.append(x)
        change.y.append(y)
        change.z.append(z)
    return change


class Simulator:
    """One scene of one server."""

    def __init__(self, address, scene):
        self.stub = service.UnionServiceStub(grpc.insecure_channel(address))
        self.scene = scene

    def create(self):
        """Makes the scene; nothing happens when it is there with the same settings."""
        stock = messages.Box(
            min=messages.Vector(x=0, y=0, z=-20),
            max=messages.Vector(x=60, y=40, z=0),
        )
        settings = messages.SceneSettings(edge=EDGE, steps_per_unit=STEPS, stock=stock)
        request = calls.CreateSceneRequest(scene=self.scene, settings=settings)
        return self.stub.CreateScene(request).scene

    def totals(self):
        request = calls.GetMassPropertiesRequest(scene=self.scene)
        return self.stub.GetMassProperties(request).mass_properties

    def revert(self, seq):
        """Makes the scene what it was at an earlier (or again a later) seq, as one new change."""
        request = calls.RevertSceneRequest(scene=self.scene, to=seq)
        return self.stub.RevertScene(request).outcome

    def history(self, **wanted):
        """What each change removed, and how fast."""
        request = calls.GetHistoryRequest(
            scene=self.scene, detail=messages.DETAIL_VOLUME, **wanted
        )
        return self.stub.GetHistory(request)

    def mill(self, lines):
        """Streams lines, and yields (number, outcome) for each once it is on stable storage.

        When the connection breaks it connects again and sends once more what was not acknowledged. A line that had been applied all
        the same is known by its key: its recorded outcome is answered. Each run has keys of its own: were they those of the lines
        alone, a second run, after going back say, would be answered with what is recorded of the first, and cut nothing.
        """
        run = uuid.uuid4().hex
        lines = iter(lines)
        waiting = {}  # Lines without an acknowledgement, by number.
        broken_since = None
        while True:
            try:
                for number, outcome in self._stream(run, lines, waiting):
                    broken_since = None
                    yield number, outcome
                return
            except grpc.RpcError as error:
                now = time.monotonic()
                broken_since = broken_since or now
                away = error.code() == grpc.StatusCode.UNAVAILABLE
                if not away or now - broken_since > PATIENCE:
                    raise
                time.sleep(0.1)

    def _stream(self, run, lines, waiting):
        """One connection: first what is waiting still, then new lines, as far ahead as the window allows."""
        outbox = queue.SimpleQueue()
        opening = calls.StreamOpening(scene=self.scene, detail=messages.DETAIL_VOLUME)
        outbox.put(calls.StreamChangesRequest(opening=opening))
        for change in waiting.values():
            outbox.put(calls.StreamChangesRequest(change=change))
        answers = self.stub.StreamChanges(iter(outbox.get, None))

        def send_ahead():
            while len(waiting) < WINDOW:
                line = next(lines, None)
                if line is None:
                    break
                change = sweep(*line)
                key = f"{run}-{change.move}"
                one = calls.StreamedChange(
                    tag=change.move, change=change, idempotency_key=key
                )
                waiting[one.tag] = one
                outbox.put(calls.StreamChangesRequest(change=one))
            if not waiting:
                outbox.put(None)  # Closes this side; the server then ends the stream.

        try:
            for answer in answers:
                kind = answer.WhichOneof("message")
                if kind == "refused":
                    problem = answer.refused.problem
                    raise SystemExit(
                        f"line {answer.refused.tag}: {problem.code}: {problem.detail}"
                    )
                if kind == "acknowledged":
                    tag = answer.acknowledged.tag
                    del waiting[tag]
                    yield tag, answer.acknowledged.outcome
                send_ahead()
        finally:
            outbox.put(None)
            answers.cancel()


def main():
    parser = argparse.ArgumentParser(description="mills a pocket on a union3d server")
    parser.add_argument("--server", default="127.0.0.1:7374", help="address of gRPC")
    parser.add_argument("--scene", default="simulated")
    arguments = parser.parse_args()

    simulator = Simulator(arguments.server, arguments.scene)
    there = simulator.create()
    print(f"scene {there.name} is at seq {there.seq} with {there.cubes} cubes")

    before = simulator.totals()
    removed = before.removed.volume
    middle, last = None, None
    print(f"{'line':>6}{'seq':>6}{'removed mm^3':>14}{'left mm^3':>14}")
    for number, outcome in simulator.mill(program()):
        volumes = outcome.volumes
        line = volumes.removed - removed
        removed = volumes.removed
        print(
            f"{number:>6}{outcome.seq:>6}{line:>14.3f}{volumes.remaining:>14.3f}",
            flush=True,
        )
        middle = outcome.seq if number == 50 else middle
        last = outcome

    print("the fastest removals, in mm^3 of a second of machine time:")
    rows = list(simulator.history(move_from=1))
    fastest = sorted(rows, key=lambda row: row.removal_rate, reverse=True)[:3]
    for row in fastest:
        print(f"  line {row.move}: {row.removal_rate:.1f} in {row.duration:.2f} s")
    idle = sum(row.volume_removed == 0 for row in rows)
    print(f"{len(rows)} lines, {idle} of which cut air")

    milled = simulator.totals()
    back = simulator.revert(middle)
    half = back.mass_properties.removed.volume
    print(f"after line 50 again (seq {back.seq}): {half:.3f} mm^3 removed")
    forth = simulator.revert(last.seq)
    again = forth.mass_properties
    print(f"and after the last: {again.removed.volume:.3f} mm^3 removed")
    if again.removed != milled.removed or again.remaining != milled.remaining:
        sys.exit("the totals after going back and forth are not those of the first time")


if __name__ == "__main__":
    main()
