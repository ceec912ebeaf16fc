"""What is made of many frames: surfaces in three dimensions."""
