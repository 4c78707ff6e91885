"""Everything that touches a file: configuration, recordings, readers and writers."""
