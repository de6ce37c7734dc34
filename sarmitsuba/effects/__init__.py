"""Effects plan: which physical effects are simulated for a scene, why, and the error of leaving one out."""
