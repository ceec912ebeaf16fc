"""The mapper: keyframes, loops, occupancy grid, meshes and saved maps in a process of its own."""
