"""Our methods beside other people's, on the same frames: how far off, how often lost, what cost."""
