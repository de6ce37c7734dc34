"""What a run will take before it is made: a model of speed, a prediction, an explanation."""
