"""The flight recorder: the last seconds of frames, kept so that they outlive the service."""
