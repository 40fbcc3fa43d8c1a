"""Dynamic environments: what a change of the scene can affect, and only that computed again."""
