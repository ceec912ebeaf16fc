"""What researchers and installers use beside the service."""
