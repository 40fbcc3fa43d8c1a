"""What a bake is worth, measured: its values against light that was followed without any of the bake's short-cuts."""
