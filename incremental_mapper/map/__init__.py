"""Map: where the points of the scans are kept, and the voxels that they are thinned to.

Knows points and the transforms that place them, nothing of clusters or the graph.
"""
