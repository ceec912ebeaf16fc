"""What stands in the virtual room, and the textures on it."""
