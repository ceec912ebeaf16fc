"""Import this before numpy: all libraries then use one thread, and CPU times are comparable."""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
