"""Odometry from frame to frame by SURF features, as Fontes and Maia propose."""
