"""The receiver: signals, messages, orbits, baseband, acquisition, tracking, PVT."""
