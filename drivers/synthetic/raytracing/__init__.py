"""Rays through the virtual room, and the light on what they meet."""
