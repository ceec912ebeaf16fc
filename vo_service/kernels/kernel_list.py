"""The list of kernels, by the part of the program that uses them.

`kernels.jsonl` is written by ``python -m scripts.list_kernels``, which runs each part: so kernels
are compiled in several processes, or for another processor, without images to run them on.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

KERNEL_FILE = Path(__file__).with_name("kernels.jsonl")


@dataclass(frozen=True)
class Signature:
    """A kernel and the types of its arguments.

    Attributes:
        kernel: Full name of the function.
        arguments: Types, as `argument_types` writes them.
    """

    kernel: str
    arguments: list[Any]

    def compile(self) -> None:
        """Compile the kernel, or load it if it is in the cache. Raises OSError."""
        from vo_service.kernels.argument_types import find_object, from_json  # imports Numba

        find_object(self.kernel).compile(tuple(map(from_json, self.arguments)))

    @property
    def text(self) -> str:
        """The signature in one line."""
        return json.dumps([self.kernel, self.arguments])


@dataclass(frozen=True)
class ListedKernel:
    """A line of the list.

    Attributes:
        part: The part of the program that uses the kernel.
        is_called: Whether Python calls it. If not, its code is in other kernels, and it is not
            loaded.
    """

    part: str
    is_called: bool
    signature: Signature


def read_kernel_list() -> list[ListedKernel]:
    """Return the kernels of each part: those called from Python in the order of their first use.

    A method that is a plug-in has none.
    """
    lines = map(json.loads, KERNEL_FILE.read_text().splitlines())
    return [ListedKernel(part, called, Signature(*signature)) for part, called, *signature in lines]
