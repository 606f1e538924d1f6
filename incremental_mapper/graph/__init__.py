"""Graph: variables and factors, and how the candidates of a window are made of them.

Builds factors and first guesses, and decides connectivity by union-find; solves nothing.
"""
