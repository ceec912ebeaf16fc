"""Playback of recorded folders and bags as a camera."""
