"""ICP on depth alone, point to plane.

Reads in order: `pyramid` (the depth image in three sizes), `planes` (the reference's surfaces),
`residuals` (how far off a frame's readings are), `directions` (which motions these settle),
`alignment` (the motion that mends them), `confidence` (whether to believe it, and how far), `track`
(the reference and the last good frame), `drawing` (what a viewer can show of it).
"""
