"""Inertial navigation: mechanization, error filter, constraints, alignment, smoothing."""
