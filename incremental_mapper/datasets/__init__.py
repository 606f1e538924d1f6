"""Datasets: folders, bags and messages in, measurements with integer stamps out.

Each kind of input is a ``Source``; drives can be made up, too (``simulated``). What is unusable is
left out and counted, never mended in silence.
"""
