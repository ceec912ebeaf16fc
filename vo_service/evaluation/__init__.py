"""How good a trajectory is: ATE, RPE, coverage, pictures."""
