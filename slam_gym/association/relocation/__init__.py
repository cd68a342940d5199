"""Searches without a prior on the pose, and the constraints, the location and the acceptance rule that they share."""
