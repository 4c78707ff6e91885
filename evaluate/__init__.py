"""Differences against truth, statistics, figures and reports."""
