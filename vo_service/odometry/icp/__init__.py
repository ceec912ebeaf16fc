"""Point-to-plane ICP on depth only.

Reading order: `depth_pyramid` (the depth image in three sizes), `planes` (planes of the reference),
`residuals` (distances of a frame's surfaces from them), `alignment` (the motion that minimizes
them), and `odometry` (validity and covariance; the reference and the last good frame).
"""
