"""Form factors: which share of the power leaving one patch reaches another. One module a technique."""
