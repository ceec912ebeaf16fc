"""What the service's processes beside the loop have in common: the recorder's, the map's."""
