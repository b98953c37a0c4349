"""Sends a million small changes over one stream, as fast as grpcio does, and says how long it took and what the server held.

    PYTHONPATH=target/python target/tools/bin/python tests/attack/stream.py PROGRAM [--changes 1000000]
"""

import argparse
import json
import sys
import tempfile
import time

import grpc

from attack import MIB, Server, ask, row
from union3d.v1 import union3d_pb2 as messages
from union3d.v1 import union_service_pb2 as calls
from union3d.v1 import union_service_pb2_grpc as service


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--changes", type=int, default=1_000_000)
    parser.add_argument("--memory", type=int, default=64, help="budget, MiB")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as data:
        server = Server(options.program, data, options.memory * MIB)
        try:
            ask(server.http, "PUT", "/v1/scenes/part", json.dumps({"edge": 2, "steps_per_unit": 1}))
            base, begun, count = server.memory("VmRSS"), time.monotonic(), 0

            def sent():
                yield calls.StreamChangesRequest(opening=calls.StreamOpening(scene="part", detail=messages.DETAIL_NONE))
                for tag in range(1, options.changes + 1):
                    yield calls.StreamChangesRequest(change=calls.StreamedChange(tag=tag, change=row(tag, 1)))

            with grpc.insecure_channel(f"127.0.0.1:{server.grpc}") as channel:
                for answer in service.UnionServiceStub(channel).StreamChanges(sent()):
                    if answer.WhichOneof("message") == "acknowledged":
                        count += 1
                        assert answer.acknowledged.tag == count, answer
                        if count % 100_000 == 0:
                            print(f"{count:>9} in {time.monotonic() - begun:.1f} s, {server.memory('VmRSS') // MIB} MiB", flush=True)
            cubes = json.loads(ask(server.http, "GET", "/v1/scenes/part/mass-properties")[1])["cubes"]
            seconds, peak = time.monotonic() - begun, server.memory("VmHWM")
            print(f"{count} of {options.changes} acknowledged, {cubes} cubes, in {seconds:.1f} s; {base // MIB} MiB before, {peak // MIB} MiB at most")
            return 0 if count == cubes == options.changes else 1
        finally:
            server.end()


if __name__ == "__main__":
    sys.exit(main())
