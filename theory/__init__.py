"""Error budgets of loops and observables; knows only the ground floor."""
