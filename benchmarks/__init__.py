"""Measurements: each a command of its own, `python -m benchmarks.NAME --help`.

Their kernels are those of this very source, as the program's and the tests' are.
"""

import os

from drivers.core.files import kernel_folder

os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_folder()))
