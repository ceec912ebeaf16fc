"""Grid of cells over the image, for weights by region."""

import numpy as np

from drivers.core.jit import inline_kernel

CELL_ROWS, CELL_COLUMNS = 6, 8
NUM_CELLS = CELL_ROWS * CELL_COLUMNS
ALL_STATIC = np.ones(NUM_CELLS, np.bool_)


@inline_kernel
def cell_index(u_share: float, v_share: float) -> int:
    """Index of the cell at a position, given as shares of the image's width and height."""
    row = min(max(int(v_share * CELL_ROWS), 0), CELL_ROWS - 1)
    column = min(max(int(u_share * CELL_COLUMNS), 0), CELL_COLUMNS - 1)
    return row * CELL_COLUMNS + column
