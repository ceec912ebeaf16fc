"""Ray tracing of the virtual room, and its lighting."""
