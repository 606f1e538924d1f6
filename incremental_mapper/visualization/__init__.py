"""Visualization: pictures of trajectories, maps and graphs, drawn from plain values."""
