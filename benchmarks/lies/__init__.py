"""Recordings that lie: each generator harms a simulated drive in one way that real ones are harmed.

``recording`` has the drive, ``lie`` what a generator is; the others are generators by subject. The
table of them all is made by ``field.py``.
"""
