"""Smoothing: the least-squares side of G(t), its newest part and the whole.

What G(t) says of its frontier is kept as a marginal prior; candidates and windows are solved on
top of it, and only what was chosen becomes part of the graph state.
"""
