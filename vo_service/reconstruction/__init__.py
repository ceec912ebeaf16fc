"""Reconstruction: TSDF volume, mesh and images of a map."""
