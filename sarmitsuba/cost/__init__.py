"""What accuracy costs: study, model and report."""
