"""Which effects a scene calls for, why, and what leaving one out would cost."""
