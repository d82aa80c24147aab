"""Judge rectified photos, and suggest from where to take the next."""
