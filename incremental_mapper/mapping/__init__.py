"""Mapping: measurements in, G(t) and its numbers out; the only room that keeps state.

The mapper gathers measurements into windows, hands each window down to the front end and to the
selection, and commits what comes back. Nothing in here looks at a point or a residual.
"""
