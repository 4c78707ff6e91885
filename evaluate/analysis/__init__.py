"""Error budgets as tables and pictures, beside what is published and what a simulation gives."""
