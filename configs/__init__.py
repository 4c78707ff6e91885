"""Ready-made settings shipped with the package."""
