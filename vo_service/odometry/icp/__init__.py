"""Point-to-plane ICP on depth only.

Reading order: `depth_pyramid` (the depth image in three sizes), `planes` (planes of the reference),
`residuals` (distances of a frame's surfaces from them), `alignment` (the motion that minimizes
them), `quality` (validity and covariance), `track` (the reference and the last good frame),
`odometry`, and `visualization` (debug data for a viewer).
"""
