"""Evaluation: every strategy on every input, and what the runs say beside each other."""
