"""Exports: a finished run in the formats of other programs, written in pieces, and read by them.

A format is told what a run holds and where to write; it knows neither the mapper nor the folder's
other files. Those of other packages come in by entry points, see ``formats``.
"""
