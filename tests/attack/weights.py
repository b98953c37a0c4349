"""What a change of a million cubes takes of the server's memory, against the bytes that were sent: the weights of src/wire/room.rs.

    PYTHONPATH=target/python target/tools/bin/python tests/attack/weights.py PROGRAM [--cubes 1000000]

Each is sent as a dry run to an empty scene of a new server, so that nothing of it stays: what the peak (VmHWM) is above what was held
before is what the request took, from its first byte until its answer.
"""

import argparse
import json
import sys
import tempfile

import grpc

from attack import MIB, Server, ask
from union3d.v1 import union3d_pb2 as messages
from union3d.v1 import union_service_pb2 as calls
from union3d.v1 import union_service_pb2_grpc as service


def change(cubes, spread):
    """Cubes side by side; their numbers are short, or as long as they can be."""
    first = 1 << 62 if spread else 1
    at = [[index % 100 * 4 - 200, index // 100 % 100 * 4 - 200, index // 10_000 * 4 - 200] for index in range(cubes)]
    if spread:
        at = [[place * 1_000_000 for place in of_one] for of_one in at]
    return range(first, first + cubes), at


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--cubes", type=int, default=1_000_000)
    options = parser.parse_args()
    path = "/v1/scenes/part/changes?dry_run=true&return=minimal"
    for spread in (False, True):
        ids, at = change(options.cubes, spread)
        insert = [{"id": number, "at": of_one} for number, of_one in zip(ids, at)]
        text = json.dumps({"insert": insert}, separators=(",", ":"))
        message = messages.Change(insert_id=ids, x=[one[0] for one in at], y=[one[1] for one in at], z=[one[2] for one in at])
        deletion = messages.Change(delete=ids)
        for name in ("JSON", "message", "gRPC", "deletion as JSON", "deletion as message"):
            with tempfile.TemporaryDirectory() as data:
                server = Server(options.program, data, 16 << 30)
                try:
                    ask(server.http, "PUT", "/v1/scenes/part", json.dumps({"edge": 2, "steps_per_unit": 1}))
                    before = server.memory("VmRSS")
                    server.reset_peak()
                    body = {"JSON": text, "deletion as JSON": json.dumps({"delete": list(ids)}, separators=(",", ":"))}.get(name)
                    sent = deletion if name == "deletion as message" else message
                    if body:
                        status, answer = ask(server.http, "POST", path, body, timeout=300)
                    elif name == "gRPC":
                        body = sent.SerializeToString()
                        with grpc.insecure_channel(f"127.0.0.1:{server.grpc}", options=[("grpc.max_send_message_length", -1)]) as channel:
                            request = calls.ApplyChangeRequest(scene="part", change=sent, dry_run=True)
                            service.UnionServiceStub(channel).ApplyChange(request)
                        status, answer = 200, b""
                    else:
                        body = sent.SerializeToString()
                        status, answer = ask(server.http, "POST", path, body, {"Content-Type": "application/x-protobuf"}, timeout=300)
                    took = server.memory("VmHWM") - before
                    numbers = "long" if spread else "short"
                    result = "" if status == 200 else f" {status} {answer[:200]!r}"
                    print(f"{name:<20} {numbers:<6} {len(body) / MIB:8.1f} MiB sent {took / MIB:8.1f} MiB taken {took / len(body):6.2f} a byte{result}", flush=True)
                finally:
                    server.end()


if __name__ == "__main__":
    sys.exit(main())
