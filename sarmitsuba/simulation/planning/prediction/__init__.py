"""Time and memory of a run before it starts: a model of speed, a prediction, an explanation of the plan."""
