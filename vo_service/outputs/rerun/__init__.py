"""Images, poses and the map in Rerun, drawn by a process of its own."""
