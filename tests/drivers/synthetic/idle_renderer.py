"""A renderer that renders nothing: ``python -m tests.drivers.synthetic.idle_renderer FD``."""

import sys
from contextlib import suppress
from multiprocessing.connection import Connection

if __name__ == "__main__":
    with Connection[object, object](int(sys.argv[1])) as reader, suppress(EOFError):
        while True:
            reader.recv()
