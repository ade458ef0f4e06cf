"""A thing for a process of its own: a sum."""

import os
import sys
from multiprocessing.connection import Connection

from avrare_metadrive.process import serve


class Counter:
    def __init__(self):
        self.total = 0

    def add(self, number):
        self.total += number
        return self.total

    def own(self):
        return os.getpid()

    def die(self):
        os._exit(3)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])), Counter())
