"""Candidates: every way of merging neighbours into clusters and of connecting these.

Pure combinatorics over stamps: no pose, no point and no solver is known here.
"""
