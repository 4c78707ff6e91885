"""Where navigation and channels meet: aiding and the epoch loop of a run."""
