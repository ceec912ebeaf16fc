"""Tools for researchers and installers, apart from the service."""
