"""report.html: a run, or a comparison, as one page that stands by itself."""
