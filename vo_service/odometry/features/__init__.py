"""Features of images: SURF, matching, 3-D points, and the verification of a motion by them."""
