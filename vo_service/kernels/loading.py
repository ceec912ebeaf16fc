"""Loading of compiled kernels, before or beside their first use."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.core.memory import release_memory
from vo_service.kernels.kernel_list import read_kernel_list


def load_kernels(part: str, stop: threading.Event) -> None:
    """Load the kernels of a part that Python calls, in the order of their first use.

    Args:
        part: Name in the list; others have no kernels.
        stop: Ends it after the current kernel.
    """
    for each in read_kernel_list():
        if each.part == part and each.is_called and not stop.is_set():
            each.signature.compile()


@contextmanager
def loading_in_background(part: str) -> Iterator[None]:
    """Load the kernels of a part in a thread, which ends with the block.

    A kernel that is used before its turn is loaded by its user. Afterwards the compiler's memory
    is released.
    """
    stop = threading.Event()

    def load() -> None:
        load_kernels(part, stop)
        release_memory()

    thread = threading.Thread(target=load, name="kernels", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
