"""Comparison of our methods and other libraries on recordings."""
