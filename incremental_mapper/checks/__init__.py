"""Checks: what an input says of itself, held against what its data show.

One small rule for every suspicion: evidence in, ``Finding`` out. A rule is a function without
state: it says what it looks at, its threshold with the evidence for it, what a user reads and what
follows from it. Who gathers the evidence (the opening of an input, the mapper, the node) is no
matter of this room, so that ``check``, ``map``, ``evaluate`` and the node ask the same rules.
"""
