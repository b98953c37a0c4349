"""Attacks a server of its own on loopback, and measures what a good client sees of it.

    PYTHONPATH=target/python target/tools/bin/python tests/attack/attack.py PROGRAM [--seconds 5] [--smoke] [--only WORD]

Each attack comes from another address (127.0.0.1) than the good client (127.0.0.2), which sends small changes and asks for totals,
one after the other. A row of the table: how often the attack was tried, what became of it, the good client's p99 quiet and during,
and the most memory that the server held meanwhile (VmHWM, reset before), beside the budget. The attackers run on the same machine and
take its processors, too: that is in the figures.

--smoke is short and judges no times: the server lives, every change of the good client is acknowledged and there, and the memory
stays within the budget and what the server held before.
"""

import argparse
import http.client
import json
import multiprocessing
import pathlib
import re
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

import grpc

from union3d.v1 import union3d_pb2 as messages
from union3d.v1 import union_service_pb2 as calls
from union3d.v1 import union_service_pb2_grpc as service

GOOD, BAD = "127.0.0.2", "127.0.0.1"
MIB = 1 << 20
JSON = {"Content-Type": "application/json"}
PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"

# What the scenes and the allocator may take besides what was there before and the budget, in the smoke run.
ALLOWANCE = 96 * MIB


class Server:
    """A server process on a data directory, with a budget."""

    def __init__(self, program, data, budget):
        arguments = ["--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0", "--memory-bytes-max", str(budget)]
        self.log = open(pathlib.Path(data) / "log", "w+")
        self.process = subprocess.Popen(
            [program, "serve", *arguments, "--data", f"{data}/data", "--log-filter", "warn"],
            stdout=subprocess.PIPE,
            stderr=self.log,
            text=True,
        )
        greeting = self.process.stdout.readline()
        found = re.search(r"http://\S+:(\d+) grpc://\S+:(\d+)", greeting)
        self.http, self.grpc = int(found[1]), int(found[2])

    def memory(self, name):
        """VmRSS or VmHWM, in bytes."""
        text = pathlib.Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.search(rf"{name}:\s+(\d+) kB", text)[1]) * 1024

    def reset_peak(self):
        pathlib.Path(f"/proc/{self.process.pid}/clear_refs").write_text("5")

    def lives(self):
        return self.process.poll() is None

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self.log.close()


def ask(port, method, path, body=None, headers=JSON, address=GOOD, timeout=60):
    """One request over a connection of its own: its status and body."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=timeout, source_address=(address, 0))
    try:
        connection.request(method, path, body, dict(headers))
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


# The good client.


def good(port, scene, first, is_off, stop, result):
    """Small changes and totals, one after the other, until it is told to stop: what it waited for, and what was acknowledged."""
    waits, sent, acknowledged, again = [], 0, 0, 0
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60, source_address=(GOOD, 0))

    def timed(method, path, body):
        nonlocal again
        begun = time.monotonic()
        while time.monotonic() - begun < 60:
            try:
                connection.request(method, path, body, JSON)
                answer = connection.getresponse()
                answer.read()
                if answer.status not in (429, 503):
                    waits.append(time.monotonic() - begun)
                    return answer.status == 200
            except (OSError, http.client.HTTPException):
                connection.close()
            again += 1
            time.sleep(0.05)
        return False

    while not stop.is_set():
        sent += 1
        number = first + sent
        body = json.dumps({"insert": [{"id": number, "at": [number % 1000, number // 1000, 0]}]})
        acknowledged += timed("POST", f"/v1/scenes/{scene}/changes?return=minimal", body)
        timed("GET", f"/v1/scenes/{scene}/mass-properties", None)
        is_off.set()
    result.put((waits, sent, acknowledged, again))


def percentile(waits, part):
    return sorted(waits)[min(len(waits) - 1, int(len(waits) * part))] * 1000 if waits else float("nan")


# Attacks. Each is run in a process of its own, by several threads, until it is told to stop; it counts what it tried.


class Attack:
    def __init__(self, server_http, server_grpc, size, stop, tried):
        self.http, self.grpc, self.size, self.stop, self.tried = server_http, server_grpc, size, stop, tried

    def count(self, number=1):
        with self.tried.get_lock():
            self.tried.value += number

    def connect(self, port, window=None):
        stream = socket.socket()
        if window:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, window)
        stream.settimeout(5)
        stream.bind((BAD, 0))
        stream.connect(("127.0.0.1", port))
        return stream

    def held(self, port, begin, step, count=100, pause=0.1):
        """Connections that are begun and then kept on by a step each now and then; new ones in place of those that were closed."""
        streams = []
        while not self.stop.is_set():
            while len(streams) < count and not self.stop.is_set():
                try:
                    stream = self.connect(port)
                    stream.sendall(begin)
                    streams.append(stream)
                    self.count()
                except OSError:
                    break
            left = []
            for stream in streams:
                try:
                    if step:
                        stream.sendall(step)
                    left.append(stream)
                except OSError:
                    stream.close()
            streams = left
            self.stop.wait(pause)
        for stream in streams:
            stream.close()

    def flood(self, frames):
        """Frames of HTTP/2, as fast as they go; a new connection when the server closes one."""
        while not self.stop.is_set():
            try:
                with self.connect(self.grpc) as stream:
                    stream.sendall(PREFACE + frame(4, 0, 0, b""))
                    stream.settimeout(1)
                    number = 1
                    while not self.stop.is_set() and number < 1 << 30:
                        stream.sendall(b"".join(frames(number + 2 * index) for index in range(64)))
                        number += 128
                        self.count(64)
            except OSError:
                time.sleep(0.01)

    def client(self):
        options = [("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)]
        return grpc.insecure_channel(f"127.0.0.1:{self.grpc}", options=options)

    # What is attacked with.

    def slow_heads(self):
        self.held(self.http, b"GET /v1/scenes HTTP/1.1\r\nHost: localhost\r\nX-A: ", b"a")

    def slow_bodies(self):
        self.held(self.http, head("bad", 1_000_000) + b"{", b" ")

    def announced_bodies(self):
        self.held(self.http, head("bad", 60_000_000) + b"{", b"", count=300)

    def unread_listings(self):
        lines = b"GET /v1/scenes/bad/cubes HTTP/1.1\r\nHost: localhost\r\nAccept: application/x-ndjson\r\n\r\n"
        self.held(self.http, lines, b"", count=60)

    def unread_events(self):
        lines = b"GET /v1/scenes/good/mass-properties/stream HTTP/1.1\r\nHost: localhost\r\n\r\n"
        self.held(self.http, lines, b"", count=100)

    def pings(self):
        self.flood(lambda _: frame(6, 0, 0, b"12345678"))

    def settings(self):
        self.flood(lambda _: frame(4, 0, 0, struct.pack(">HI", 4, 70_000)))

    def resets(self):
        fields = b"\x83\x86\x04\x01/\x01\x09localhost"
        self.flood(lambda number: frame(1, 4, number, fields) + frame(3, 0, number, struct.pack(">I", 8)))

    def connections(self):
        while not self.stop.is_set():
            try:
                self.connect(self.http).close()
                self.count()
            except OSError:
                time.sleep(0.01)

    def audits(self):
        while not self.stop.is_set():
            self.request("POST", "/v1/scenes/bad/audit", b"{}")

    def large_changes(self):
        insert = [{"id": 10_000_000 + index, "at": [index % 1000, index // 1000, 50]} for index in range(self.size)]
        bodies = [
            json.dumps({"insert": insert}, separators=(",", ":")).encode(),
            json.dumps({"delete": [cube["id"] for cube in insert]}).encode(),
        ]
        while not self.stop.is_set():
            for body in bodies:
                self.request("POST", "/v1/scenes/bad/changes?return=minimal", body)

    def request(self, method, path, body):
        try:
            ask(self.http, method, path, body, address=BAD)
            self.count()
        except (OSError, http.client.HTTPException):
            time.sleep(0.05)

    def unread_streams(self):
        """Streams of changes whose acknowledgements nobody reads."""
        streams = []
        for number in range(10):
            with_all = self.messages(number)
            channel = self.client()
            streams.append((channel, service.UnionServiceStub(channel).StreamChanges(with_all)))
        self.stop.wait()
        for channel, stream in streams:
            stream.cancel()
            channel.close()

    def messages(self, number):
        yield calls.StreamChangesRequest(opening=calls.StreamOpening(scene="bad"))
        for tag in range(1 << 30):
            if self.stop.is_set():
                return
            change = row(20_000_000 + number * 1_000_000 + tag % 900 * 1000, 1000)
            self.count()
            yield calls.StreamChangesRequest(change=calls.StreamedChange(tag=tag, change=change))

    def large_messages(self):
        change = row(30_000_000, self.size)
        with self.client() as channel:
            stub = service.UnionServiceStub(channel)
            while not self.stop.is_set():
                try:
                    stub.ApplyChange(calls.ApplyChangeRequest(scene="bad", change=change, dry_run=True), timeout=60)
                except grpc.RpcError as error:
                    if error.code() != grpc.StatusCode.RESOURCE_EXHAUSTED:
                        time.sleep(0.05)
                        continue
                self.count()


THREADS = {"audits": 8, "large_changes": 4, "large_messages": 4, "pings": 2, "settings": 2, "resets": 2, "connections": 2}
ATTACKS = [
    "slow_heads",
    "slow_bodies",
    "announced_bodies",
    "unread_listings",
    "unread_events",
    "pings",
    "settings",
    "resets",
    "connections",
    "audits",
    "large_changes",
    "unread_streams",
    "large_messages",
]


def frame(kind, flags, stream, content):
    """A frame of HTTP/2."""
    return struct.pack(">I", len(content))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + content


def head(scene, length):
    lines = f"POST /v1/scenes/{scene}/changes HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
    return lines.encode()


def row(first, count):
    """A change that inserts so many cubes."""
    ids = range(first, first + count)
    x, y = [number % 1000 for number in ids], [number // 1000 % 1000 for number in ids]
    return messages.Change(insert_id=ids, x=x, y=y, z=[100] * count)


def attacker(name, http_port, grpc_port, size, stop, tried):
    attack = Attack(http_port, grpc_port, size, stop, tried)
    threads = [threading.Thread(target=getattr(attack, name), daemon=True) for _ in range(THREADS.get(name, 1))]
    for thread in threads:
        thread.start()
    stop.wait()
    for thread in threads:
        thread.join(20)


def measured(server, first, seconds, name=None, size=0):
    """What the good client sees for so long, while it is attacked: what it waited for, sent, and was acknowledged; and trials."""
    is_off, stop, over, result = *(multiprocessing.Event() for _ in range(3)), multiprocessing.Queue()
    tried = multiprocessing.Value("q", 0)
    process = None
    if name:
        arguments = (name, server.http, server.grpc, size, over, tried)
        process = multiprocessing.Process(target=attacker, args=arguments, daemon=True)
        process.start()
        begun = time.monotonic()
        while tried.value == 0 and time.monotonic() - begun < 30:
            time.sleep(0.05)
    client = multiprocessing.Process(target=good, args=(server.http, "good", first, is_off, stop, result), daemon=True)
    client.start()
    is_off.wait(60)
    time.sleep(seconds)
    stop.set()
    found = result.get(timeout=120)
    client.join()
    over.set()
    if process:
        process.join(30)
        if process.is_alive():
            process.kill()
    return *found, tried.value


def acknowledged_cubes(server):
    _, body = ask(server.http, "GET", "/v1/scenes/good/mass-properties")
    return json.loads(body)["cubes"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--seconds", type=float, default=5.0, help="for each measurement")
    parser.add_argument("--memory", type=int, default=256, help="budget, MiB")
    parser.add_argument("--size", type=int, default=1_000_000, help="cubes of a large change")
    parser.add_argument("--only", help="attacks whose names have this in them")
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args()
    if options.smoke:
        options.seconds, options.memory, options.size = 0.7, 64, 20_000
    faults = []
    with tempfile.TemporaryDirectory() as data:
        server = Server(options.program, data, options.memory * MIB)
        try:
            for scene in ("good", "bad"):
                ask(server.http, "PUT", f"/v1/scenes/{scene}", json.dumps({"edge": 2, "steps_per_unit": 1}))
            first = 0
            for part in range(1, 1 + options.size // 5 // 1000):
                change = row(part * 1000, 1000)
                ask(server.http, "POST", "/v1/scenes/bad/changes?return=minimal", change.SerializeToString(), {"Content-Type": "application/x-protobuf"})
            print(f"budget {options.memory} MiB, {options.seconds} s each, large changes of {options.size} cubes", flush=True)
            titles = ("attack", "trials", "result", "p50 before", "during", "p99 before", "during", "peak MiB", "was MiB")
            print("{:<18}{:>10}  {:<30}{:>11}{:>9}{:>12}{:>9}{:>10}{:>9}".format(*titles), flush=True)
            for name in ATTACKS:
                if options.only and options.only not in name:
                    continue
                quiet, sent, done, _, _ = measured(server, first, options.seconds)
                first += sent
                base = server.memory("VmRSS")
                server.reset_peak()
                waits, more, also, again, tried = measured(server, first, options.seconds, name, options.size)
                first, sent, done = first + more, sent + more, done + also
                result = "lives" if server.lives() else "ENDED"
                if done != sent:
                    result += f", {sent - done} of {sent} NOT DONE"
                result += f", {again} sent again" if again else ""
                peak = server.memory("VmHWM") if server.lives() else 0
                figures = [percentile(of, part) for part in (0.5, 0.99) for of in (quiet, waits)]
                text = "{:<18}{:>10}  {:<30}{:>11.1f}{:>9.1f}{:>12.1f}{:>9.1f}{:>10}{:>9}"
                print(text.format(name, tried, result, *figures, peak // MIB, base // MIB), flush=True)
                if not server.lives():
                    faults.append(f"{name}: the server has ended")
                    break
                if done != sent or acknowledged_cubes(server) != first:
                    faults.append(f"{name}: {done} of {sent} changes are acknowledged, {acknowledged_cubes(server)} cubes of {first} are there")
                if tried == 0:
                    faults.append(f"{name}: nothing was tried")
                if options.smoke and peak > base + options.memory * MIB + ALLOWANCE:
                    faults.append(f"{name}: {peak} bytes of memory, {base} before")
        finally:
            server.end()
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    multiprocessing.set_start_method("spawn")
    sys.exit(main())
