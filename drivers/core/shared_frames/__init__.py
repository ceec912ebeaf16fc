"""A ring of frames in shared memory, written by the service and read by its workers."""
