"""What recordings of all formats share: frames, images, pairing, gravity."""
