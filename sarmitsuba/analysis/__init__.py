"""What images tell: their quality, and what polarisations and pairs of passes say of the scene."""
