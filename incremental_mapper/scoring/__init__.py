"""Scoring: what makes one candidate better than another; lower is better.

Strategies are a criterion plus a way of finding candidates. The criteria see proposals and a local
map, never the graph or the mapper.
"""
