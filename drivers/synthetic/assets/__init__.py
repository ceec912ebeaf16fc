"""Furniture and textures of the virtual room."""
