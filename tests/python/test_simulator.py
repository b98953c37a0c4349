"""Runs the simulator against a real server that is killed while it mills, and against one that is not: the same comes of it."""

import argparse
import pathlib
import re
import subprocess
import sys
import tempfile

import simulator

HERE = pathlib.Path(__file__).parent
LINE = re.compile(r"^ *(\d+) +(\d+) +([\d.-]+) +([\d.]+)$")


class Server:
    """A server process on a data directory."""

    def __init__(self, binary, data, address="127.0.0.1:0"):
        self.process = subprocess.Popen(
            [binary, "serve", "--http", "127.0.0.1:0", "--grpc", address]
            + ["--data", data, "--log-filter", "warn"],
            stdout=subprocess.PIPE,
            text=True,
        )
        greeting = self.process.stdout.readline()
        self.address = greeting.split("grpc://")[1].strip()

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def mill(binary, kill_after):
    """What the simulator prints; the server is killed and started again after so many lines, if any."""
    with tempfile.TemporaryDirectory() as data:
        server = Server(binary, data)
        simulator = subprocess.Popen(
            [sys.executable, HERE / "simulator.py", "--server", server.address],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            printed = []
            for line in simulator.stdout:
                printed.append(line.rstrip())
                if kill_after and len(printed) == kill_after:
                    server.kill()
                    server = Server(binary, data, server.address)
            status = simulator.wait()
            assert status == 0, f"the simulator ended with {status}: {printed[-3:]}"
            return printed
        finally:
            simulator.kill()
            simulator.wait()
            server.kill()


def mill_again(binary):
    """The totals of a run, and of two more after going back to the beginning: by the same simulator, and by another."""
    with tempfile.TemporaryDirectory() as data:
        server = Server(binary, data)
        try:
            first = simulator.Simulator(server.address, "again")
            first.create()
            totals = []
            for one in (first, first, simulator.Simulator(server.address, "again")):
                one.revert(0)
                assert one.totals().removed.volume == 0
                numbers = [number for number, _ in one.mill(simulator.program())]
                assert numbers == list(range(1, 101)), numbers
                totals.append(one.totals().removed)
            return totals
        finally:
            server.kill()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("binary")
    binary = parser.parse_args().binary

    printed = mill(binary, None)
    lines = [LINE.match(line) for line in printed]
    lines = [[float(cell) for cell in line.groups()] for line in lines if line]
    assert [line[0] for line in lines] == list(range(1, 101)), "a line is missing"
    # The lowest row is at -5 mm, the last at 36 mm across, and the cutter reaches 3 mm further than its centre.
    removed = sum(line[2] for line in lines)
    assert abs(removed - 60 * 39 * 8) < 0.01, removed
    assert abs(removed + lines[-1][3] - 60 * 40 * 20) < 0.01, lines[-1]
    assert any("cut air" in line for line in printed), printed

    # Killed in the middle, the same lines removed the same.
    broken = mill(binary, 30)
    assert broken == printed, "a server that died in the middle made a difference"

    # After going back the same program removes the same again.
    first, *later = mill_again(binary)
    assert abs(first.volume - 60 * 39 * 8) < 0.01, first
    assert later == [first, first], "a second run does not remove what the first one did"
    print("\n".join(printed[-8:]))


if __name__ == "__main__":
    main()
