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

# Beside kernels that were compiled for a kind of processors: its name.
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
    """Let Numba use the kernels of a folder if they are for a kind of processors as this one.

    Variables that the user has set have precedence.
    """
    file = folder / PROCESSOR_FILE
    if "NUMBA_CPU_NAME" not in os.environ and file.is_file():
        name = file.read_text().strip()
        if can_run(name):
            compile_for(name)


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
    """Whether the compiler (LLVM) knows a kind of processors of this architecture.

    It only warns of an unknown one, in a line on standard error.
    """
    code = (
        "import sys; from llvmlite import binding; binding.initialize_native_target(); "
        "binding.Target.from_default_triple().create_target_machine(cpu=sys.argv[1], features='')"
    )
    done = subprocess.run([sys.executable, "-c", code, name], stderr=subprocess.PIPE, check=True)
    return b"not a recognized processor" not in done.stderr


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
