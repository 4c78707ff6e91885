"""Command line: the only place that prints or exits."""
