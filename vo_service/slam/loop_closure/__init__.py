"""Loop closure."""
