"""The compiled kernels of each part: their list, and how they are compiled and loaded."""
