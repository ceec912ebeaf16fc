"""Where the places are: the motions between them, corrected where a place is met again."""
