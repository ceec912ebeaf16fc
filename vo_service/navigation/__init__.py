"""What a driving robot needs of depth: distances in a plane, and the map of occupied cells."""
