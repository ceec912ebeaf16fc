"""Places that are known again: loops, and what they say of the way."""
