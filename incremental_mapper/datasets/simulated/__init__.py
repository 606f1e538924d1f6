"""Simulated drives, written as KAIST Urban folders with exact ground truth."""
