"""When the machine is too slow: what to give up, and when to take it back."""
