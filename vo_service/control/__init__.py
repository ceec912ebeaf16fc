"""What others may ask of the running service: commands, and how they reach the loop."""
