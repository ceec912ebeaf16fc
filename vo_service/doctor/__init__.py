"""What is wrong with this computer's sensor, and how to mend it."""
