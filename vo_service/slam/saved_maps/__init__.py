"""Maps of keyframes, saved and loaded again."""
