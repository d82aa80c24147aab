"""A material: its maps, their files, made ones."""
