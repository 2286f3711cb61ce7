"""Screening of a grid: a fault at each bus or a trip of each branch, the worst first."""
