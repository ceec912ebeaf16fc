"""The flight recorder: the last seconds of frames, which survive a crash of the service."""
