"""The flight recorder: the last seconds of frames, saved after a loss, on command or a crash."""
