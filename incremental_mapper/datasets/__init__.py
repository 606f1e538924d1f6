"""Datasets: folders, bags and messages in, measurements with integer stamps out."""
