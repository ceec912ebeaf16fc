"""Import this before numpy: everything then runs on one thread, and CPU time is comparable."""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
