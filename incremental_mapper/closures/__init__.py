"""Loop closure: where a drive, or another one, passes a place again. Solves nothing.

Local maps in, verified relative poses out: what holds them in a graph is the caller's business.
"""
