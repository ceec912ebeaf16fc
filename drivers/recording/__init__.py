"""Recordings of any format: their contents, decoding of images, buffers for playback."""
