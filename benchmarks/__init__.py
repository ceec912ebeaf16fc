"""Measurements: `python -m benchmarks` lists them, `python -m benchmarks NAME --help` explains one.

Numeric libraries use one thread, so that CPU times are comparable. The kernels are those of this
source, as the program's and the tests' are. Programs that a benchmark starts have cached bytecode,
as an installed program has.
"""

import os

from drivers.core.folders import kernel_folder

# The libraries read these when they are loaded.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
# Without bytecode the first pose of a service is twice as late.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_folder()))
