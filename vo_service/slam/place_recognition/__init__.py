"""Place recognition: keyframes of a map and their recognition in new views."""
