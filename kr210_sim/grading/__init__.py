"""Solvers written by others: run apart from us, judged pose by pose and cycle by cycle."""
