"""Measurements: `python -m benchmarks` lists them, `python -m benchmarks NAME --help` explains one.

Numeric libraries use one thread, so that CPU times are comparable. The kernels are those of this
source, as the program's and the tests' are.
"""

import os

from drivers.core.folders import kernel_folder

# The libraries read these when they are loaded.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_folder()))
