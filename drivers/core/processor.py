"""The processor that kernels are compiled for: this one, or a kind of them, as an image carries.

Numba compiles for the processor that it runs on, unless its variables name another one. Kernels of
different processors have the same results, bit for bit, and different speeds.
"""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

from drivers.core.files import atomic_write
from drivers.core.write_errors import writing

# Beside kernels that were compiled for kinds of processors: their names, one in each line.
PROCESSOR_FILE = "processor"
# Names of the System V ABI for x86-64, and the flags in /proc/cpuinfo that each adds.
X86_64_LEVELS = {
    "x86-64-v2": "cx16 lahf_lm popcnt sse4_1 sse4_2 ssse3",
    "x86-64-v3": "abm avx avx2 bmi1 bmi2 f16c fma movbe xsave",
    "x86-64-v4": "avx512f avx512bw avx512cd avx512dq avx512vl",
}
# What tells processors apart for which Numba compiles different code.
_IDENTITY = re.compile(r"^(model name|flags|Features|CPU (?:implementer|variant|part))\s*: (.*)$")
_CPU_INFO = Path("/proc/cpuinfo")


def use_carried_kernels(folder: Path) -> None:
    """Let Numba use the best kernels of a folder that are for a kind of processors as this one.

    Variables that the user has set have precedence.
    """
    if "NUMBA_CPU_NAME" not in os.environ:
        names = sorted(_carried_kinds(folder), key=_level)
        name = next(filter(can_run, reversed(names)), None)
        if name is not None:
            compile_for(name)


def add_carried_kernels(folder: Path, name: str) -> None:
    """Note that a folder has kernels for a kind of processors. Raises WriteError."""
    names = [*(each for each in _carried_kinds(folder) if each != name), name]
    with writing(folder):
        atomic_write(folder / PROCESSOR_FILE, "".join(f"{each}\n" for each in names).encode())


def _carried_kinds(folder: Path) -> list[str]:
    file = folder / PROCESSOR_FILE
    return file.read_text().split() if file.is_file() else []


def _level(name: str) -> int:
    """A name of one processor is better than each level."""
    return list(X86_64_LEVELS).index(name) if name in X86_64_LEVELS else len(X86_64_LEVELS)


def compile_for(name: str) -> None:
    """Let Numba compile for a kind of processors; it must not be imported yet."""
    os.environ["NUMBA_CPU_NAME"] = name
    os.environ["NUMBA_CPU_FEATURES"] = ""  # those that all of them have


def can_run(name: str) -> bool:
    """Whether this processor runs what is compiled for a kind of processors.

    That is known of the levels of x86-64; another name must be LLVM's name of this processor.
    """
    if name in X86_64_LEVELS:
        levels = list(X86_64_LEVELS)[: list(X86_64_LEVELS).index(name) + 1]
        needed = {flag for level in levels for flag in X86_64_LEVELS[level].split()}
        return needed <= set(_cpu_info().get("flags", "").split())
    from llvmlite import binding  # slow to import

    return bool(binding.get_host_cpu_name() == name)


def is_known(name: str) -> bool:
    """Whether the compiler (LLVM) compiles for a kind of processors of this architecture.

    It only warns of an unknown one, in a line on standard error, and ends the process for one with
    another size of addresses.
    """
    code = (
        "import sys; from llvmlite import binding; binding.initialize_native_target(); "
        "binding.initialize_native_asmprinter(); target = binding.Target.from_default_triple(); "
        "machine = target.create_target_machine(cpu=sys.argv[1], features=''); "
        "machine.emit_object(binding.parse_assembly('define void @f() { ret void }'))"
    )
    done = subprocess.run([sys.executable, "-c", code, name], capture_output=True)
    return bool(name) and done.returncode == 0 and not done.stderr


def processor_identity() -> str:
    """Return a text that differs between processors that need kernels of their own."""
    return os.environ.get("NUMBA_CPU_NAME") or repr(sorted(_cpu_info().items()))


def _cpu_info() -> dict[str, str]:
    """Properties of the first processor in /proc/cpuinfo (Linux, proc(5))."""
    try:
        first = _CPU_INFO.read_text().split("\n\n")[0]
    except OSError:
        return {"machine": platform.machine()}
    return {match[1]: match[2] for line in first.splitlines() if (match := _IDENTITY.match(line))}
