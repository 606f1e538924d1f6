"""Results: an offline run, and the folder that a run is written to and read back from."""
