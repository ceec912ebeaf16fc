"""Methods run over recordings, each run in a process of its own; what they did is kept."""
