"""Sessions: maps that are gone on with, and finished runs that become one.

A saved folder is enough: ``session.bin`` has the whole graph as GTSAM holds it, ``map.ply`` the
points, each with the scan that saw it first. Sessions meet in the frame of the first one, and are
solved together; what cannot be placed there is never drawn into it.
"""
