"""Reconstruction: TSDF volume, mesh, views of it."""
