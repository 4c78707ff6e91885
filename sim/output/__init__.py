"""What a simulation leaves in its folder."""

from deepgnss.sim.output.folder import FILES, File, Written, write_simulation

__all__ = ["FILES", "File", "Written", "write_simulation"]
