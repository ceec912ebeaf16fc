"""Camera files from views of a board, and the timing of a sensor."""
