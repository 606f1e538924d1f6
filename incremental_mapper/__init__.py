"""Window-by-window selection of the factor graph that makes the best local map."""

__version__ = '0.1.0'
