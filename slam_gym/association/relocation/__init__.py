"""Searches without a prior on the pose, and the constraints, location and acceptance rule that they share."""
