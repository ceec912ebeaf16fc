"""Other people's odometry in the place of ours; each is loaded only when it is made."""
