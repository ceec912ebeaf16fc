"""How the virtual camera moves."""
