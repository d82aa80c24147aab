"""Error measures of maps, photos, images and gradients; they read and write no files."""
