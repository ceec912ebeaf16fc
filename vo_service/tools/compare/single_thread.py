"""Limit numeric libraries to one thread. Import this before numpy.

The libraries read these variables when they are loaded.
"""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"
