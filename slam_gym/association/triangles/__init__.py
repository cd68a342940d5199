"""The parts of `association.index`: triangles of features by their sides, look-up, verification, pose."""
