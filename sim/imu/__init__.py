"""Inertial sensors as simulated: exact increments, vibration, wheel speed."""
