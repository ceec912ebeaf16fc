"""Images, poses and the map in Rerun, drawn by a separate process."""
