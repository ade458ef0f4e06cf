"""Adaptive cruise control behind a car that brakes: simulator or controller of `avrare-process`.

It needs no package, and can be copied and changed. Messages are lines of JSON on standard input and
output, or on the port of 127.0.0.1 in AVRARE_PORT.
"""

import json
import os
import socket
import sys


class Road:
    """One world: gap to the car ahead [m], both speeds [m/s], error of the radar [m]."""

    hello = {
        "outputs": ["gap", "speed"],
        "seen": ["measured gap", "speed", "speed ahead"],
        "noise": ["radar"],
        "dt": 0.1,
        "copy": True,
    }

    def __init__(self, options):
        self.radar = options.get("radar", 1.0)
        self.time, self.gap, self.speed, self.lead, self.error = 0.0, 40.0, 25.0, 25.0, 0.0

    def step(self, action, noise):
        self.speed = max(self.speed + 0.1 * action[0], 0.0)
        braking = 6.0 if 3.0 < self.time < 7.0 else 0.0
        self.lead = max(self.lead - 0.1 * braking, 0.0)
        self.gap += 0.1 * (self.lead - self.speed)
        self.error = 0.95 * self.error + self.radar * noise[0]
        self.time += 0.1

    def read(self):
        return [self.gap, self.speed, self.gap + self.error, self.speed, self.lead]


class Cruise:
    """Acceleration [m/s^2] from the newest observation; it remembers nothing."""

    hello = {"outputs": ["acceleration"], "memory": False}

    def __init__(self, options):
        self.time_gap, self.acceleration = options.get("time_gap", 1.3), 0.0

    def step(self, seen, noise):
        gap, speed, lead = seen
        acceleration = 0.3 * (gap - 3.0 - self.time_gap * speed) + (lead - speed)
        self.acceleration = min(max(acceleration, -8.0), 2.0)

    def read(self):
        return [self.acceleration]


def serve(reader, writer):
    """Answer each message by a line."""
    worlds = {}
    for line in reader:
        message = json.loads(line)
        numbers, answer = message.get("worlds", []), {}
        if message["do"] == "hello":
            part, options = {"simulator": Road, "controller": Cruise}[message["role"]], message["options"]
            answer = part.hello
        elif message["do"] == "reset":
            worlds |= {number: part(options) for number in numbers}
        elif message["do"] == "step":
            inputs = message["inputs"] or [None] * len(numbers)
            for number, row, noise in zip(numbers, inputs, message["noise"]):
                worlds.setdefault(number, part(options)).step(row, noise)
        elif message["do"] == "copy":
            for source, target in zip(message["from"], message["to"]):
                worlds[target] = part(options)
                vars(worlds[target]).update(vars(worlds[source]))
        else:
            return
        if numbers:
            answer = {"outputs": [worlds[number].read() for number in numbers]}
        writer.write(json.dumps(answer) + "\n")
        writer.flush()


if __name__ == "__main__":
    if "AVRARE_PORT" in os.environ:
        connection = socket.create_connection(("127.0.0.1", int(os.environ["AVRARE_PORT"])))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else answers wait
        serve(connection.makefile("r"), connection.makefile("w"))
    else:
        serve(sys.stdin, sys.stdout)
