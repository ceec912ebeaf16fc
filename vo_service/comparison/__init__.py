"""Methods beside each other on recordings: running them, keeping what they did, the report."""
