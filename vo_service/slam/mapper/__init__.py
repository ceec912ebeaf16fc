"""The mapper: keyframes, loop closure, meshes and saved maps in a process of its own."""
