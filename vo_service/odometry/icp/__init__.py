"""ICP on depth alone, point to plane.

Reads in order: `pyramid` (the depth image in three sizes), `planes` (the reference's surfaces),
`residuals` (how far off a frame's readings are), `alignment` (the motion that mends it),
`confidence` (whether to believe it, and how far), `track` (the reference and the last good frame).
"""
